"""A term of a user's own, which neither the loss nor the stepper has heard of."""

import pytest
import torch
from small_losses import action_of, gradients, make_batch, make_loss
from torch import nn

from morlnav.objectives import LossTerm


class Effort(LossTerm):
    """Large actions cost, more where a battery is low."""

    in_keys = ("battery",)

    def actor(self, acted):
        effort = (acted.action / acted.half_range).square().sum(-1)
        return effort / acted.batch["battery"]


class Modesty(LossTerm):
    """Large values cost."""

    def critic(self, judged):
        return judged.scalarise(judged.values).square()


def make_case():
    batch = make_batch()
    batch["battery"] = torch.rand(12) + 0.5
    return make_loss(), make_loss(terms={"effort": Effort(), "modesty": Modesty()}), batch


def test_it_is_added_to_the_loss_that_it_is_written_for_and_reported_by_its_name():
    plain, loss, batch = make_case()
    expected = (action_of(loss, batch) / 2).square().sum(-1) / batch["battery"]
    before, after = plain(batch.clone()), loss(batch.clone())
    torch.testing.assert_close(after["effort_actor"], expected)
    torch.testing.assert_close(after["loss_actor"], before["loss_actor"] + expected.mean())
    weights = torch.cat([torch.ones(12, 1), batch["preference"]], -1)
    expected = (weights * before["pred_value"]).sum(-1).square()
    torch.testing.assert_close(after["modesty_qvalue"], expected)
    torch.testing.assert_close(after["loss_qvalue"], before["loss_qvalue"] + expected.sum(0).mean())
    assert set(after.keys()) == set(loss.out_keys)
    assert "battery" in loss.in_keys


def test_its_gradient_moves_actor_or_critics():
    plain, loss, batch = make_case()
    for method, params in (("actor_loss", "actor_network_params"), ("value_loss", "qvalue_network_params")):
        for each in (plain, loss):
            getattr(each, method)(batch)[0].backward()
        before, after = (gradients(getattr(each, params)) for each in (plain, loss))
        assert all(not torch.equal(*pair) for pair in zip(before, after, strict=True))


def test_it_may_ask_for_the_values_of_other_actions_and_what_the_policy_was_measured_to_reach():
    class Curious(LossTerm):
        def actor(self, acted):
            own = acted.value_of(acted.action.unsqueeze(0))
            assert own.shape == (1, 12, 3)
            torch.testing.assert_close(own.squeeze(0), acted.values)
            return torch.zeros(12)

    loss = make_loss(terms={"curious": Curious()})
    loss.actor_loss(make_batch())
    loss.terms["curious"].update(torch.eye(2), torch.rand(2, 3))  # most terms need none of it


def test_a_penalty_of_another_shape_is_refused_by_name():
    class Column(LossTerm):
        def actor(self, acted):
            return acted.action.square()

    with pytest.raises(ValueError, match=r"column_actor must have the shape \(12,\), got \(12, 1\)"):
        make_loss(terms={"column": Column()}).actor_loss(make_batch())


def test_what_is_no_term_is_refused_by_name():
    with pytest.raises(TypeError, match="terms must be LossTerms, got Linear for 'mine'"):
        make_loss(terms={"mine": nn.Linear(1, 1)})
