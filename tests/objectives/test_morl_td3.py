"""MORLTD3Loss against a slow loop over samples, critics and objectives, written from the equations."""

import copy
import math
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torch.nn.functional import l1_loss, mse_loss, smooth_l1_loss
from torchrl.data import Bounded, Composite, LazyTensorStorage, TensorDictReplayBuffer, Unbounded
from torchrl.modules import MLP, TanhModule
from torchrl.objectives import SoftUpdate, ValueEstimators
from torchrl.trainers.algorithms.td3 import TD3OptimizationStepper

from morlnav.data import UniformPreferences
from morlnav.modules import PreferenceInterpolator, VectorCritic
from morlnav.objectives import AngleTerm, ClampedAngleTerm, Guidance, LinearScalarisation, MORLTD3Loss
from morlnav.transforms import HindsightPreferenceRelabel

STATE, ACTION = 3, 1
LOW, HIGH = torch.tensor([-2.0]), torch.tensor([2.0])
DISTANCES = {"l2": mse_loss, "l1": l1_loss, "smooth_l1": smooth_l1_loss}
SIZES = [(1, 1), (2, 2), (3, 2), (4, 2), (5, 5)]  # objectives m, preference entries n; m - n are static


class Concatenate(nn.Module):
    """A plain MLP on whatever it is given."""

    def __init__(self, inputs, outputs, last=None):
        super().__init__()
        self.mlp = MLP(inputs, outputs, depth=1, num_cells=16, activation_class=nn.Tanh)
        self.last = last or nn.Identity()

    def forward(self, *inputs):
        return self.last(self.mlp(*inputs))


def networks(m, n, preference="preference", action="action", value="state_action_value"):
    actor = TensorDictModule(Concatenate(STATE + n, ACTION, nn.Tanh()), ["observation", preference], [action])
    critics = [
        TensorDictModule(Concatenate(STATE + n + ACTION, m), ["observation", preference, action], [value])
        for _ in range(2)
    ]
    return actor, critics


def make_loss(m=3, n=2, **options):
    torch.manual_seed(options.pop("seed", 0))
    actor, critics = networks(m, n)
    options = {"bounds": (LOW, HIGH), "policy_noise": 0.0, "loss_function": "l2", **options}
    loss = MORLTD3Loss(actor, critics, **options)
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.9)
    with torch.no_grad():  # targets that differ from the networks tell the two apart
        for params in (loss.target_actor_network_params, loss.target_qvalue_network_params):
            for tensor in params.values(True, True):
                tensor.data.add_(0.3 * torch.randn_like(tensor))
    return loss


def make_batch(m=3, n=2, count=12, seed=1):
    torch.manual_seed(seed)
    preference = UniformPreferences(n)(count)
    terminated = torch.rand(count, 1) < 0.3
    return TensorDict(
        {
            "observation": torch.randn(count, STATE),
            "preference": preference,
            "action": torch.rand(count, ACTION) * 4 - 2,
            "next": {
                "observation": torch.randn(count, STATE),
                "preference": preference.clone(),
                "reward": torch.randn(count, m),
                "terminated": terminated,
                "done": terminated | (torch.rand(count, 1) < 0.3),
            },
        },
        [count],
    )


def call(loss, network, params, *inputs):
    """One network on single samples, through its own parameters."""
    module = getattr(loss, network)
    with params.to_module(module):
        return module.module(*inputs)


def angle_between(a, b):
    cosine = ((a * b).sum() / (a.norm() * b.norm())).item()
    return math.acos(max(-1.0, min(1.0, cosine)))


def slow_losses(loss, batch, gamma=0.9, distance="l2", angle=None, direction=None):
    """Actor and critic losses per sample, and targets, by loops over everything."""
    q, q_target = loss.qvalue_network_params, loss.target_qvalue_network_params
    actor_losses, critic_losses, targets = [], [], []
    for sample in batch.unbind(0):
        m = sample["next", "reward"].shape[-1]
        lam = sample["preference"]
        w = torch.cat([torch.ones(m - len(lam)), lam])
        lam_p = direction(lam) if direction is not None else w

        following = sample["next"]
        action = call(loss, "actor_network", loss.target_actor_network_params, following["observation"], lam)
        action = action.clamp(LOW, HIGH)
        twins = [call(loss, "qvalue_network", q_target[i], following["observation"], lam, action) for i in range(2)]
        smaller = min(twins, key=lambda value: (w @ value).item())
        y = sample["next", "reward"] + gamma * (not following["terminated"].item()) * smaller
        targets.append(y.detach())

        critic = 0.0
        for i in range(2):
            value = call(loss, "qvalue_network", q[i], sample["observation"], lam, sample["action"])
            for k in range(m):
                critic = critic + DISTANCES[distance](value[k], y[k].detach())
            if angle is not None:
                critic = critic + angle.critic * angle_between(lam_p, value)
        critic_losses.append(critic)

        action = call(loss, "actor_network", loss.actor_network_params, sample["observation"], lam)
        value = call(loss, "qvalue_network", q[0], sample["observation"], lam, action)
        actor_losses.append(-(w @ value) + (angle.actor * angle_between(lam_p, value) if angle is not None else 0.0))
    return torch.stack(actor_losses).detach(), torch.stack(critic_losses).detach(), torch.stack(targets)


def gradients(params):
    return [tensor.grad for tensor in params.values(True, True) if tensor.grad is not None]


# The equations


@pytest.mark.parametrize(("m", "n"), SIZES)
@pytest.mark.parametrize("distance", DISTANCES)
def test_losses_and_targets_are_those_of_the_equations(m, n, distance):
    loss, batch = make_loss(m, n, loss_function=distance), make_batch(m, n)
    actor, critic, targets = slow_losses(loss, batch, distance=distance)
    out = loss(batch)
    torch.testing.assert_close(out["loss_actor"], actor.mean())
    torch.testing.assert_close(out["loss_qvalue"], critic.mean())
    torch.testing.assert_close(out["target_value"], targets)


def test_every_entry_may_have_a_discount_of_its_own():
    loss, batch, gamma = make_loss(), make_batch(), torch.tensor([0.9, 0.5, 0.99])
    loss.make_value_estimator(ValueEstimators.TD0, gamma=gamma)
    _, critic, targets = slow_losses(loss, batch, gamma=gamma)
    out = loss(batch)
    torch.testing.assert_close(out["target_value"], targets)
    torch.testing.assert_close(out["loss_qvalue"], critic.mean())


@pytest.mark.parametrize(("m", "n"), SIZES[1:])
def test_angles_enter_both_losses_with_their_coefficients(m, n):
    angle = AngleTerm(actor=10.0, critic=2.0)
    keys = torch.eye(n)
    interpolator = PreferenceInterpolator(n, m - n, preferences=keys, values=torch.randn(n, m))
    loss, batch = make_loss(m, n, angle=angle, interpolator=interpolator), make_batch(m, n)
    actor, critic, _ = slow_losses(loss, batch, angle=angle, direction=interpolator)
    torch.testing.assert_close(loss.actor_loss(batch)[0], actor.mean(), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(loss.value_loss(batch)[0], critic.mean(), rtol=1e-4, atol=1e-4)


def test_without_an_interpolator_the_direction_is_the_weight_vector():
    angle = AngleTerm(actor=3.0, critic=1.0)
    loss, batch = make_loss(angle=angle), make_batch()
    actor, critic, _ = slow_losses(loss, batch, angle=angle)
    torch.testing.assert_close(loss.actor_loss(batch)[0], actor.mean(), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(loss.value_loss(batch)[0], critic.mean(), rtol=1e-4, atol=1e-4)


def test_the_target_is_one_twins_whole_vector_not_a_minimum_by_entry():
    loss, batch = make_loss(), make_batch(count=64)
    following = loss.value_loss(batch)[1]["next_state_value"]
    inputs = batch["next"].select("observation", "preference")
    action = call(loss, "actor_network", loss.target_actor_network_params, *inputs.values())
    q = loss.target_qvalue_network_params
    twins = torch.stack([call(loss, "qvalue_network", q[i], *inputs.values(), action) for i in range(2)])
    whole = (twins - following).abs().amax(-1).amin(0)
    torch.testing.assert_close(whole, torch.zeros(64), atol=1e-5, rtol=0)
    assert ((following - twins.amin(0)).abs().amax(-1) > 1e-3).any()


@pytest.mark.parametrize("pessimism", [0.0, 0.25])
def test_pessimism_mixes_the_smaller_twin_with_the_mean(pessimism):
    batch = make_batch()
    smaller, mixed = (make_loss(pessimism=b).value_loss(batch)[1]["next_state_value"] for b in (1.0, pessimism))
    inputs = batch["next"].select("observation", "preference")
    loss = make_loss()
    action = call(loss, "actor_network", loss.target_actor_network_params, *inputs.values())
    q = loss.target_qvalue_network_params
    mean = sum(call(loss, "qvalue_network", q[i], *inputs.values(), action) for i in range(2)) / 2
    torch.testing.assert_close(mixed, pessimism * smaller + (1 - pessimism) * mean)


def test_targets_stay_within_what_rewards_can_add_up_to():
    batch = make_batch()
    batch["next", "reward"].clamp_(-0.1, 0.1)
    free, bounded = (
        make_loss(reward_bounds=bounds).value_loss(batch)[1]["target_value"]
        for bounds in (None, ([-0.01, -0.1, 0.01], [0.0, 0.1, math.inf]))
    )
    low, high = torch.tensor([-0.1, -1.0, 0.0]), torch.tensor([0.0, 1.0, math.inf])  # γ = 0.9: ten steps' worth
    assert ((free < low) | (free > high)).any(0)[[0, 2]].all()
    torch.testing.assert_close(bounded, free.clamp(low, high))


def test_without_a_discount_only_the_signs_of_rewards_bound_their_sum():
    loss, batch = make_loss(reward_bounds=(-1.0, 0.0)), make_batch()
    loss.value_estimator.gamma.fill_(1.0)
    with torch.no_grad():
        loss.target_qvalue_network_params.apply_(lambda parameter: parameter.mul_(100))
    batch["next", "reward"].clamp_(max=0)
    target = loss.value_loss(batch)[1]["target_value"]
    assert target.max() == 0
    assert target.min() < -100


def test_termination_stops_bootstrapping_and_truncation_does_not():
    loss, batch = make_loss(), make_batch(count=3)
    terminated, done = torch.tensor([[True], [False], [False]]), torch.tensor([[True], [True], [False]])
    batch["next"].update({"terminated": terminated, "done": done, "truncated": done & ~terminated})
    _, metadata = loss.value_loss(batch)
    ahead = metadata["target_value"] - batch["next", "reward"]
    torch.testing.assert_close(ahead, torch.tensor([[0.0], [0.9], [0.9]]) * metadata["next_state_value"])


def test_target_noise_is_clipped_in_half_ranges_and_actions_keep_their_bounds():
    seen = []
    loss, batch = make_loss(policy_noise=5.0, noise_clip=0.25), make_batch(count=400)
    loss.qvalue_network.module.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[-1].detach()))
    loss.deactivate_vmap = True
    loss._make_vmap()
    loss.value_loss(batch)
    inputs = batch["next"].select("observation", "preference").values()
    quiet = call(loss, "actor_network", loss.target_actor_network_params, *inputs)
    moved = (seen[0] - quiet).abs()
    assert moved.max() <= 0.25 * 2 + 1e-5  # half the action range is 2
    assert moved.median() > 0.4
    assert seen[0].abs().max() <= 2


# Gradients


def test_the_actors_loss_moves_the_actor_alone():
    loss, batch = make_loss(angle=AngleTerm(1.0, 1.0)), make_batch()
    loss.actor_loss(batch)[0].backward()
    assert gradients(loss.actor_network_params)
    assert all(gradient.abs().sum() > 0 for gradient in gradients(loss.actor_network_params))
    for params in (
        loss.qvalue_network_params,
        loss.target_actor_network_params,
        loss.target_qvalue_network_params,
    ):
        assert not gradients(params)


def test_the_critics_loss_moves_both_critics_alone():
    loss, batch = make_loss(angle=AngleTerm(1.0, 1.0)), make_batch()
    loss.value_loss(batch)[0].backward()
    found = gradients(loss.qvalue_network_params)
    assert found
    assert all((gradient.flatten(1).abs().sum(1) > 0).all() for gradient in found)  # leading dimension: critics
    for params in (loss.actor_network_params, loss.target_actor_network_params, loss.target_qvalue_network_params):
        assert not gradients(params)


def test_the_actor_listens_to_the_first_critic_only():
    loss, batch = make_loss(), make_batch()
    before = loss.actor_loss(batch)[0].item()
    with torch.no_grad():
        loss.qvalue_network_params[1].apply_(lambda tensor: tensor.add_(1.0))
    assert loss.actor_loss(batch)[0].item() == before
    with torch.no_grad():
        loss.qvalue_network_params[0].apply_(lambda tensor: tensor.add_(1.0))
    assert loss.actor_loss(batch)[0].item() != before


def test_the_actor_may_climb_the_mean_of_both_critics():
    loss, both, batch = make_loss(), make_loss(actor_qvalue_nets=2), make_batch()
    other = make_loss()
    both.load_state_dict(loss.state_dict())
    other.load_state_dict(loss.state_dict())
    with torch.no_grad():
        other.qvalue_network_params.data.copy_(loss.qvalue_network_params.data.flip(0).contiguous())
    terms = [each.actor_loss(batch)[0] for each in (loss, other, both)]
    torch.testing.assert_close(terms[2], (terms[0] + terms[1]) / 2)
    terms[2].backward()
    assert not gradients(both.qvalue_network_params)
    with pytest.raises(ValueError, match="actor_qvalue_nets must be between 1 and 2, got 3"):
        make_loss(actor_qvalue_nets=3)


def test_the_interpolated_direction_gets_no_gradient():
    interpolator = nn.Linear(2, 3)
    loss, batch = make_loss(angle=AngleTerm(1.0, 1.0), interpolator=interpolator), make_batch()
    (loss.actor_loss(batch)[0] + loss.value_loss(batch)[0]).backward()
    assert interpolator.weight.grad is None


@pytest.mark.parametrize(("separate", "gets"), [(False, True), (True, False)])
def test_shared_parameters_may_be_kept_from_the_critics_gradient(separate, gets):
    torch.manual_seed(0)
    shared = nn.Linear(STATE, 8)
    head, value = nn.Linear(8 + 2, ACTION), nn.Linear(8 + 2 + ACTION, 3)

    class Shared(nn.Module):
        def __init__(self, last):
            super().__init__()
            self.body, self.last = shared, last

        def forward(self, observation, *others):
            return self.last(torch.cat([self.body(observation), *others], -1))

    actor = TensorDictModule(Shared(head), ["observation", "preference"], ["action"])
    critic = TensorDictModule(Shared(value), ["observation", "preference", "action"], ["state_action_value"])
    loss = MORLTD3Loss(actor, critic, bounds=(LOW, HIGH), separate_losses=separate)
    loss.make_value_estimator(gamma=0.9)
    loss.value_loss(make_batch())[0].backward()
    names = {name for name, tensor in loss.actor_network_params.flatten_keys(".").items() if tensor.grad is not None}
    assert not any("last" in name for name in names)
    in_critic = {
        name: tensor.grad is not None and bool(tensor.grad.abs().sum() > 0)
        for name, tensor in loss.qvalue_network_params.flatten_keys(".").items()
    }
    assert in_critic["module.last.weight"]
    assert in_critic["module.body.weight"] == gets
    if separate:
        with pytest.raises(ValueError, match="separate_losses needs a single critic that is copied"):
            MORLTD3Loss(actor, [critic, copy.copy(critic)], bounds=(LOW, HIGH), separate_losses=True)


@pytest.mark.parametrize(
    "wrap", [lambda critic: critic, lambda critic: [critic], lambda critic: nn.ModuleList([critic])]
)
def test_the_only_critic_learns_from_its_own_weights_on(wrap):
    actor, (critic, _) = networks(3, 2)
    own = [parameter.detach().clone() for parameter in critic.parameters()]
    loss = MORLTD3Loss(actor, wrap(critic), bounds=(LOW, HIGH), num_qvalue_nets=1)
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.9)
    learned = list(loss.qvalue_network_params.parameters())
    for weights in (learned, loss.target_qvalue_network_params.values(True, True)):
        for mine, theirs in zip(weights, own, strict=True):
            assert torch.equal(mine.squeeze(0), theirs)
    loss.value_loss(make_batch())[0].backward()
    assert all(parameter.grad.abs().sum() > 0 for parameter in learned)


def test_listed_critics_must_be_as_many_as_said_and_different():
    actor, critics = networks(3, 2)
    for wrong, number in ((critics[:1] * 2, 2), (critics, 3)):
        with pytest.raises(ValueError, match=f"must list num_qvalue_nets={number} different critics"):
            MORLTD3Loss(actor, wrong, bounds=(LOW, HIGH), num_qvalue_nets=number)


# The angle


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


# Reductions and weights


def test_no_reduction_gives_every_sample_its_loss():
    loss, batch = make_loss(reduction="none"), make_batch()
    actor, critic, _ = slow_losses(loss, batch)
    torch.testing.assert_close(loss.actor_loss(batch)[0], actor)
    torch.testing.assert_close(loss.value_loss(batch)[0], critic)


def test_a_sum_is_a_sum():
    loss, batch = make_loss(reduction="sum"), make_batch()
    torch.testing.assert_close(loss.value_loss(batch)[0], slow_losses(loss, batch)[1].sum())


@pytest.mark.parametrize("setting", ["auto", True])
def test_importance_weights_make_a_weighted_mean(setting):
    loss, batch = make_loss(use_prioritized_weights=setting), make_batch()
    actor, critic, _ = slow_losses(loss, batch)
    weight = torch.rand(12) + 0.1
    batch["priority_weight"] = weight
    torch.testing.assert_close(loss.value_loss(batch)[0], (weight * critic).sum() / weight.sum())
    torch.testing.assert_close(loss.actor_loss(batch)[0], (weight * actor).sum() / weight.sum())


def test_importance_weights_can_be_ignored():
    loss, batch = make_loss(use_prioritized_weights=False), make_batch()
    batch["priority_weight"] = torch.rand(12)
    torch.testing.assert_close(loss.value_loss(batch)[0], slow_losses(loss, batch)[1].mean())


def test_a_loop_over_critics_gives_the_same_numbers_as_vmap():
    batch = make_batch()
    vmap, loop = (
        make_loss(deactivate_vmap=setting, angle=AngleTerm(1.0, 1.0))(batch.clone()) for setting in (False, True)
    )
    for key, value in vmap.items():
        torch.testing.assert_close(value, loop[key])


@pytest.mark.parametrize("shape", [(12,), (4, 3)])
def test_stacked_critics_give_the_same_losses_and_gradients_as_vmap(shape):
    torch.manual_seed(0)
    actor = TensorDictModule(Concatenate(STATE + 2, ACTION, nn.Tanh()), ["observation", "preference"], ["action"])
    features = nn.Identity()
    features.out_features = STATE
    critics = [VectorCritic(3, 2, LOW, HIGH, features, depth=2, num_cells=16) for _ in range(2)]
    keys = ["observation", "preference", "action"]
    losses, batch = [], make_batch().reshape(shape)
    for stackable in (True, False):
        for critic in critics:
            critic.stackable = stackable
        modules = [TensorDictModule(critic, keys, ["state_action_value"]) for critic in critics]
        loss = MORLTD3Loss(copy.deepcopy(actor), copy.deepcopy(modules), bounds=(LOW, HIGH), policy_noise=0.0)
        loss.make_value_estimator(ValueEstimators.TD0, gamma=0.9)
        out = loss(batch.clone())
        (out["loss_qvalue"] + out["loss_actor"]).backward()
        losses.append((out, loss))
    (stacked, ours), (mapped, theirs) = losses
    for key, value in mapped.items():
        torch.testing.assert_close(stacked[key], value)
    for (name, mine), (_, other) in zip(ours.named_parameters(), theirs.named_parameters(), strict=True):
        if other.grad is not None:
            torch.testing.assert_close(mine.grad, other.grad, msg=name)


@pytest.mark.parametrize("copies", [1, 4])
def test_relabelled_batches_of_any_shape_are_learned_from(copies):
    relabel = HindsightPreferenceRelabel(UniformPreferences(2), num_relabels=copies)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(64), transform=relabel, batch_size=8)
    buffer.extend(make_batch(count=64))
    batch = buffer.sample()
    loss = make_loss()
    out = loss(batch.clone())
    flat = loss(batch.flatten())
    assert batch.ndim == (2 if copies > 1 else 1)
    for key in ("loss_actor", "loss_qvalue"):
        torch.testing.assert_close(out[key], flat[key])
    assert loss.value_loss(batch)[1]["td_error"].shape == (2, *batch.batch_size)


# TorchRL's conventions


def test_every_key_can_be_renamed_even_to_nested_ones():
    batch, expected = make_batch(), make_loss()(make_batch())
    torch.manual_seed(0)
    names = {"preference": ("wish", "weights"), "action": ("agent", "move"), "value": "q"}
    actor, critics = networks(3, 2, **names)
    loss = MORLTD3Loss(actor, critics, bounds=(LOW, HIGH), policy_noise=0.0, loss_function="l2")
    loss.make_value_estimator(gamma=0.9)
    loss.set_keys(
        preference=("wish", "weights"),
        action=("agent", "move"),
        state_action_value="q",
        reward=("pay", "vector"),
        done="over",
        terminated="ended",
        priority="importance",
    )
    torch.manual_seed(0)
    reference = make_loss()
    for name in ("actor_network_params", "qvalue_network_params", "target_actor_network_params"):
        getattr(loss, name).data.update_(getattr(reference, name).data)
    loss.target_qvalue_network_params.data.update_(reference.target_qvalue_network_params.data)
    moved = (
        ("preference", ("wish", "weights")),
        ("action", ("agent", "move")),
        (("next", "preference"), ("next", "wish", "weights")),
        (("next", "reward"), ("next", "pay", "vector")),
        (("next", "done"), ("next", "over")),
        (("next", "terminated"), ("next", "ended")),
    )
    for old, new in moved:
        batch.rename_key_(old, new)
    out = loss(batch)
    for key, value in expected.items():
        torch.testing.assert_close(out[key], value)
    assert batch["importance"].shape == (12,)
    assert ("wish", "weights") in loss.in_keys
    assert ("next", "pay", "vector") in loss.in_keys


def test_only_the_entries_in_in_keys_are_read():
    loss, batch = make_loss(), make_batch()
    full = loss(batch.clone())
    fewer = loss(batch.select(*loss.in_keys))
    assert torch.equal(full["loss_qvalue"], fewer["loss_qvalue"])


def test_the_critic_may_see_more_than_the_actor():
    actor, _ = networks(3, 2)
    keys = ["observation", "context", "preference", "action"]
    critic = TensorDictModule(Concatenate(STATE + 2 + 2 + ACTION, 3), keys, ["state_action_value"])
    loss = MORLTD3Loss(actor, critic, bounds=(LOW, HIGH))
    batch = make_batch()
    batch["context"], batch["next", "context"] = torch.randn(12, 2), torch.randn(12, 2)
    assert {"context", ("next", "context")} <= set(loss.in_keys)
    out = loss(batch)
    (out["loss_actor"] + out["loss_qvalue"]).backward()
    batch["next", "context"] += 1.0
    assert not torch.equal(loss(batch)["target_value"], out["target_value"])
    assert torch.equal(loss(batch)["loss_actor"], out["loss_actor"])


def test_it_may_be_called_with_tensors():
    loss, batch = make_loss(), make_batch()
    inputs = {"_".join(key) if isinstance(key, tuple) else key: batch[key] for key in loss.in_keys}
    out = loss(**inputs)
    assert len(out) == len(loss.out_keys) == 6  # no angle here
    torch.testing.assert_close(out[0], loss(batch)["loss_actor"])


def test_the_td_error_leads_with_the_critics_and_becomes_the_priority():
    loss, batch = make_loss(), make_batch()
    _, metadata = loss.value_loss(batch)
    assert metadata["td_error"].shape == (2, 12)
    squared = (metadata["pred_value"] - metadata["target_value"]).square().sum(-1)
    torch.testing.assert_close(metadata["td_error"], squared)
    loss(batch)
    torch.testing.assert_close(batch["td_error"], squared.amax(0))


def test_torchrls_own_stepper_and_soft_update_drive_it():
    loss = make_loss()
    batch = make_batch(count=64)
    optimizers = [
        torch.optim.Adam(list(params.parameters()), 1e-2)
        for params in (loss.actor_network_params, loss.qvalue_network_params)
    ]
    stepper = TD3OptimizationStepper(*optimizers, policy_update_delay=2)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(64), batch_size=64)
    buffer.extend(batch)
    trainer = SimpleNamespace(
        clip_grad_norm=True,
        clip_norm=10.0,
        replay_buffer=buffer,
        loss_module=loss,
        compute_loss=lambda data, method: getattr(loss, method)(data),
    )
    update = SoftUpdate(loss, tau=0.05)
    start = loss.target_qvalue_network_params.data.clone()
    losses = []
    for _ in range(60):
        losses.append(stepper.step(trainer, batch)["loss_qvalue"].item())
        update.step()
    assert losses[-1] < 0.9 * losses[0]
    assert (start != loss.target_qvalue_network_params.data).any()


def test_soft_updates_move_both_targets_by_their_share():
    loss = make_loss()
    update = SoftUpdate(loss, tau=0.25)  # which starts with targets equal to the networks
    before = loss.target_actor_network_params.data.clone(), loss.target_qvalue_network_params.data.clone()
    with torch.no_grad():
        for params in (loss.actor_network_params, loss.qvalue_network_params):
            params.apply_(lambda tensor: tensor.add_(1.0))
    update.step()
    for old, target, source in zip(
        before,
        (loss.target_actor_network_params, loss.target_qvalue_network_params),
        (loss.actor_network_params, loss.qvalue_network_params),
        strict=True,
    ):
        expected = old * 0.75 + source.data * 0.25
        for key in expected.keys(True, True):
            torch.testing.assert_close(target.data[key], expected[key])


def test_one_critic_module_is_copied_with_weights_of_its_own():
    actor, critics = networks(3, 2)
    loss = MORLTD3Loss(actor, critics[0], bounds=(LOW, HIGH), num_qvalue_nets=4)
    first = next(tensor for tensor in loss.qvalue_network_params.values(True, True) if tensor.ndim == 3)
    assert first.shape[0] == 4
    assert len(first.flatten(1).unique(dim=0)) == 4


def test_foreign_networks_on_a_pendulum_work_with_torchrls_spec():
    spec = Composite(action=Bounded(LOW, HIGH))
    policy = TensorDictSequential(
        TensorDictModule(MLP(5, 1, depth=1, num_cells=8), ["observation", "preference"], ["raw"]),
        TanhModule(in_keys=["raw"], out_keys=["action"], spec=spec["action"]),
    )
    keys = ["observation", "preference", "action"]
    critic = TensorDictModule(MLP(6, 3, depth=1, num_cells=8), keys, ["state_action_value"])
    loss = MORLTD3Loss(policy, critic, action_spec=spec)
    out = loss(make_batch())
    (out["loss_actor"] + out["loss_qvalue"]).backward()
    assert gradients(loss.actor_network_params)
    assert gradients(loss.qvalue_network_params)


# Mistakes


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"bounds": None}, "exactly one of 'action_spec' and 'bounds'"),
        ({"action_spec": Bounded(-1, 1, shape=(1,))}, "exactly one of 'action_spec' and 'bounds'"),
        ({"bounds": None, "action_spec": Unbounded(1)}, "action_spec must be Bounded, got Unbounded"),
        ({"bounds": (HIGH, LOW)}, "Every lower action bound must be below the upper one"),
        ({"loss_function": "wrong"}, "loss_function must be one of l2, l1, smooth_l1, got wrong"),
        ({"pessimism": 1.5}, "pessimism must be between 0 and 1, got 1.5"),
        ({"reward_bounds": (1.0, 0.0)}, r"reward_bounds must be \(low, high\) with low <= high"),
    ],
)
def test_wrong_arguments_are_named(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        make_loss(**options)


def test_the_bounds_of_a_batched_spec_are_those_of_one_action():
    spec = Bounded(LOW.expand(6, 1), HIGH.expand(6, 1))
    loss = make_loss(bounds=None, action_spec=spec)
    assert loss.min_action.tolist() == [-2.0]
    assert loss.max_action.tolist() == [2.0]


def test_other_value_estimators_are_refused():
    with pytest.raises(NotImplementedError, match="supports TD0 targets"):
        make_loss().make_value_estimator(ValueEstimators.TDLambda)


def test_a_preference_longer_than_the_rewards_is_refused():
    with pytest.raises(ValueError, match="preference of 3 entries cannot weigh 2 objectives"):
        LinearScalarisation()(torch.rand(4, 3), 2)


def test_ties_are_broken_by_a_small_weight_on_every_tuneable_objective():
    weights = LinearScalarisation(tie_break=0.1)(torch.tensor([1.0, 0.0]), 3)
    torch.testing.assert_close(weights, torch.tensor([1.0, 1.1, 0.1]))


def test_ties_may_be_broken_by_some_objectives_alone():
    weights = LinearScalarisation(tie_break=[0.0, 0.3])(torch.tensor([[1.0, 0.0], [0.0, 1.0]]), 3)
    torch.testing.assert_close(weights, torch.tensor([[1.0, 1.0, 0.3], [1.0, 0.0, 1.3]]))


def test_styles_may_weigh_less_than_static_objectives():
    weights = LinearScalarisation(scale=[0.5, 1.0], tie_break=[0.0, 0.3])(torch.tensor([[1.0, 0.0], [0.0, 1.0]]), 4)
    torch.testing.assert_close(weights, torch.tensor([[1.0, 1.0, 0.5, 0.3], [1.0, 1.0, 0.0, 1.3]]))


def test_wrong_scales_and_tie_breaks_are_named():
    with pytest.raises(ValueError, match="scale must be positive"):
        LinearScalarisation(scale=0.0)
    with pytest.raises(ValueError, match="tie_break must not be negative"):
        LinearScalarisation(tie_break=[0.1, -0.1])
    with pytest.raises(ValueError, match="tie_break has 2 entries, the preference 3"):
        LinearScalarisation(tie_break=[0.1, 0.1])(torch.rand(4, 3), 4)


def value_of(loss, batch, action, critic=0):
    """Value vectors of one critic."""
    with loss.qvalue_network_params.detach()[critic].to_module(loss.qvalue_network):
        return loss.qvalue_network(batch.clone().set("action", action))["state_action_value"]


def action_of(loss, batch):
    with loss.actor_network_params.to_module(loss.actor_network):
        return loss.actor_network(batch.clone())["action"]


def guided(**options):
    guide = TensorDictModule(lambda observation: observation[..., :1].clamp(-2, 2), ["observation"], ["action"])
    return make_loss(
        guidance=Guidance(guide, entry=1, **{"coefficient": 0.5, "sharpness": 2.0, "margin": 0.0, **options})
    )


def test_guidance_pulls_toward_the_guide_where_the_other_objectives_agree():
    loss, batch = guided(), make_batch()
    plain, _ = make_loss().actor_loss(batch)
    total, metadata = loss.actor_loss(batch)
    action, proposal = action_of(loss, batch), batch["observation"][:, :1].clamp(-2, 2)
    gain = value_of(loss, batch, proposal) - value_of(loss, batch, action)
    agreed = (LinearScalarisation()(batch["preference"], 3) * gain)[:, :2].sum(-1) >= 0  # the third is guided
    expected = 0.5 * batch["preference"][:, 1] ** 2 * agreed * ((action - proposal) / 2).square().sum(-1)
    torch.testing.assert_close(metadata["guidance"], expected)
    assert 0 < (expected > 0).sum() < len(batch)
    torch.testing.assert_close(total, plain + expected.mean())


def test_a_margin_decides_how_much_loss_guidance_may_cost():
    batch = make_batch()
    always, never = (guided(margin=margin).actor_loss(batch)[1]["guidance"] for margin in (1e6, -1e6))
    assert (always > 0).all()
    assert (never == 0).all()


def test_a_search_pulls_at_every_preference_only_toward_what_is_clearly_better():
    guide = TensorDictModule(lambda observation: observation[..., :1].clamp(-2, 2), ["observation"], ["action"])
    batch = make_batch()
    search = Guidance(guide, entry=None, coefficient=0.5, margin=-0.05)
    loss = make_loss(guidance=search)
    _, metadata = loss.actor_loss(batch)
    action, proposal = action_of(loss, batch), batch["observation"][:, :1].clamp(-2, 2)
    gain = value_of(loss, batch, proposal) - value_of(loss, batch, action)
    better = (LinearScalarisation()(batch["preference"], 3) * gain).sum(-1) >= 0.05
    expected = 0.5 * better * ((action - proposal) / 2).square().sum(-1)
    torch.testing.assert_close(metadata["guidance"], expected)
    assert 0 < (expected > 0).sum() < len(batch)


def test_of_several_proposals_the_best_one_pulls():
    batch, levels = make_batch(), torch.tensor([-1.5, -0.5, 0.5, 1.5])
    guide = TensorDictModule(
        lambda observation: levels.view(4, 1, 1).expand(*observation.shape[:-1], 1), ["observation"], ["action"]
    )
    loss = make_loss(guidance=Guidance(guide, entry=None, coefficient=0.5, margin=0.0, proposals=4))
    _, metadata = loss.actor_loss(batch)

    def scalar(action):
        return (LinearScalarisation()(batch["preference"], 3) * value_of(loss, batch, action)).sum(-1)

    action = action_of(loss, batch)
    values = torch.stack([scalar(level.expand(len(batch), 1)) for level in levels])
    best = levels[values.argmax(0)].unsqueeze(-1)
    expected = 0.5 * (values.max(0).values >= scalar(action)) * ((action - best) / 2).square().sum(-1)
    torch.testing.assert_close(metadata["guidance"], expected)
    assert expected.any()
    assert len(best.unique()) > 1


def test_a_clone_is_silent_where_one_critic_objects_or_a_search_knows_better():
    batch = make_batch()
    clone, ahead = (
        TensorDictModule(
            lambda observation, sign=sign: sign * observation[..., :1].clamp(-2, 2), ["observation"], ["action"]
        )
        for sign in (1, -1)
    )
    searching = Guidance(ahead, entry=None, coefficient=0.0, margin=0.0)
    loss = make_loss(actor_qvalue_nets=2, guidance=[Guidance(clone, entry=1, sharpness=0.0, margin=0.05), searching])
    _, metadata = loss.actor_loss(batch)

    action, proposal = action_of(loss, batch), batch["observation"][:, :1].clamp(-2, 2)
    weights, others, known = LinearScalarisation()(batch["preference"], 3), [], []
    for critic in range(2):
        own, clones, searched = (value_of(loss, batch, act, critic) for act in (action, proposal, -proposal))
        others.append((weights * (clones - own))[:, :2].sum(-1))  # the third is guided
        known.append((weights * (searched - own)).sum(-1))
    known = (sum(known) / 2).clamp(min=0)
    agreed = torch.stack(others).amin(0) >= -0.05
    expected = 0.3 * (torch.stack(others).amin(0) - known >= -0.05) * ((action - proposal) / 2).square().sum(-1)
    torch.testing.assert_close(metadata["guidance"], expected)
    assert 0 < (expected > 0).sum() < agreed.sum() < (torch.stack(others).mean(0) >= -0.05).sum()


def test_a_guide_without_proposals_is_refused():
    with pytest.raises(ValueError, match="at least one action, got 0 proposals"):
        Guidance(TensorDictModule(nn.Identity(), ["observation"], ["action"]), proposals=0)


def test_guidance_teaches_the_actor_and_leaves_guide_and_critics_alone():
    torch.manual_seed(0)
    guide = TensorDictModule(nn.Linear(STATE, ACTION), ["observation"], ["action"])
    loss = make_loss(guidance=Guidance(guide, margin=1e6))
    loss.actor_loss(make_batch())[0].backward()
    assert all(parameter.grad is None for parameter in guide.parameters())
    assert all(parameter.grad is None for parameter in loss.qvalue_network_params.parameters())
    assert all(parameter.grad is not None for parameter in loss.actor_network_params.parameters())


def test_a_repelling_guidance_is_refused():
    with pytest.raises(ValueError, match="must not be negative"):
        Guidance(TensorDictModule(nn.Identity(), ["observation"], ["action"]), coefficient=-1.0)


def test_no_guidance_may_be_an_empty_list():
    loss = make_loss(guidance=[])
    assert "guidance" not in loss.out_keys
    assert torch.isfinite(loss(make_batch())["loss_actor"])


def test_a_guided_entry_counted_from_the_end_is_refused():
    with pytest.raises(ValueError, match="from 0 on, got -1"):
        Guidance(TensorDictModule(torch.nn.Identity(), ["observation"], ["action"]), entry=-1)
