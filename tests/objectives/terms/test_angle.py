"""The angle term: the angle itself, and what it adds to the losses."""

import math

import pytest
import torch
from small_losses import SIZES, angle_between, make_batch, make_loss, slow_losses
from torch import nn

from morlnav.modules import PreferenceInterpolator
from morlnav.objectives import AngleTerm, ClampedAngleTerm


@pytest.mark.parametrize(("m", "n"), SIZES[1:])
def test_angles_enter_both_losses_with_their_coefficients(m, n):
    interpolator = PreferenceInterpolator(n, m - n, preferences=torch.eye(n), values=torch.randn(n, m))
    loss = make_loss(m, n, terms={"angle": AngleTerm(actor=10.0, critic=2.0, interpolator=interpolator)})
    batch = make_batch(m, n)
    actor, critic, _ = slow_losses(loss, batch, angle=(10.0, 2.0), direction=interpolator)
    torch.testing.assert_close(loss.actor_loss(batch)[0], actor.mean(), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(loss.value_loss(batch)[0], critic.mean(), rtol=1e-4, atol=1e-4)


def test_without_an_interpolator_the_direction_is_the_weight_vector():
    loss, batch = make_loss(terms={"angle": AngleTerm(actor=3.0, critic=1.0)}), make_batch()
    actor, critic, _ = slow_losses(loss, batch, angle=(3.0, 1.0))
    torch.testing.assert_close(loss.actor_loss(batch)[0], actor.mean(), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(loss.value_loss(batch)[0], critic.mean(), rtol=1e-4, atol=1e-4)


def test_the_interpolated_direction_gets_no_gradient():
    interpolator = nn.Linear(2, 3)
    loss, batch = make_loss(terms={"angle": AngleTerm(1.0, 1.0, interpolator)}), make_batch()
    (loss.actor_loss(batch)[0] + loss.value_loss(batch)[0]).backward()
    assert interpolator.weight.grad is None


def test_its_penalties_are_reported_under_the_name_that_it_has_in_the_loss():
    plain, batch = make_loss(), make_batch()
    for term, names in ((AngleTerm(2.0, 0.0), {"turn_actor"}), (AngleTerm(2.0, 3.0), {"turn_actor", "turn_qvalue"})):
        loss = make_loss(terms={"turn": term})
        out = loss(batch.clone())
        assert set(out.keys()) == set(loss.out_keys) == set(plain.out_keys) | names
        torch.testing.assert_close(out["loss_actor"], plain(batch.clone())["loss_actor"] + out["turn_actor"].mean())


@pytest.mark.parametrize("interpolated", [True, False])
def test_static_entries_may_be_left_out_of_the_angle_and_of_what_is_interpolated(interpolated):
    keys, measured = torch.eye(2), torch.tensor([[7.0, 3.0, -1.0], [-9.0, -2.0, 4.0]])
    given = PreferenceInterpolator(2, preferences=keys, decay=0.5) if interpolated else None
    term = AngleTerm(10.0, 2.0, given, tuneable_only=True)
    interpolator = term.interpolator
    loss, batch = make_loss(terms={"angle": term}), make_batch()
    term.update(keys, measured)
    if interpolated:
        assert interpolator.decay == 0.5
        torch.testing.assert_close(interpolator.values, measured[:, 1:])
        torch.testing.assert_close(interpolator(keys), nn.functional.normalize(measured[:, 1:], dim=-1))

    plain, actor, critics = make_loss(), [], []
    value, values = (
        plain.actor_loss(batch)[1]["state_action_value_actor"],
        plain.value_loss(batch)[1]["pred_value"],
    )
    for i, preference in enumerate(batch["preference"]):
        direction = interpolator(preference) if interpolated else preference
        actor.append(angle_between(direction, value[i, 1:]))
        critics.append([angle_between(direction, values[k, i, 1:]) for k in range(2)])
    out = loss(batch)
    torch.testing.assert_close(out["angle_actor"], 10 * torch.tensor(actor), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(out["angle_qvalue"], 2 * torch.tensor(critics).T, rtol=1e-4, atol=1e-4)


def test_the_clamped_angle_has_no_gradient_beyond_ninety_degrees_and_the_safe_one_has():
    direction, opposite = torch.tensor([1.0, 0.2]), torch.tensor([-1.0, 0.4])
    for term, dead in ((ClampedAngleTerm(), True), (AngleTerm(), False)):
        value = opposite.clone().requires_grad_()
        term(direction, value).backward()
        assert (value.grad.abs().sum() == 0) == dead


@pytest.mark.parametrize("term", [AngleTerm(), ClampedAngleTerm()], ids=["safe", "clamped"])
@pytest.mark.parametrize("value", [[2.0, 0.0], [-2.0, 0.0], [0.0, 0.0], [0.0, 3.0], [1e-8, 0.0], [1e6, 1.0]])
def test_angles_and_their_gradients_are_finite_everywhere(term, value):
    value = torch.tensor(value, requires_grad=True)
    angle = term(torch.tensor([1.0, 0.0]), value)
    angle.backward()
    assert angle.isfinite()
    assert value.grad.isfinite().all()


@pytest.mark.parametrize("degrees", [1, 30, 90, 120, 179])
def test_the_safe_angle_is_the_angle(degrees):
    turned = torch.tensor([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    for scale in (0.01, 1.0, 500.0):
        assert AngleTerm(degrees=True)(torch.tensor([3.0, 0.0]), scale * turned).item() == pytest.approx(
            degrees, abs=0.01
        )
        assert AngleTerm()(torch.tensor([3.0, 0.0]), scale * turned).item() == pytest.approx(
            math.radians(degrees), abs=2e-4
        )


def test_both_forms_agree_where_neither_is_clamped():
    direction, value = torch.rand(50, 3) + 0.1, torch.rand(50, 3) * torch.tensor([1.0, 0.2, 3.0])
    safe, clamped = AngleTerm()(direction, value), ClampedAngleTerm()(direction, value)
    apart = safe > 0.05
    torch.testing.assert_close(safe[apart], clamped[apart], atol=1e-3, rtol=0)


def test_negative_coefficients_are_refused():
    with pytest.raises(ValueError, match="must not be negative"):
        AngleTerm(actor=-1.0)
