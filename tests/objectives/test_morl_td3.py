"""MORLTD3Loss against a slow loop over samples, critics and objectives, written from the equations."""

from types import SimpleNamespace

import pytest
import torch
from small_losses import DISTANCES, SIZES, call, gradients, make_batch, make_loss, slow_losses
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.objectives import SoftUpdate, ValueEstimators
from torchrl.trainers.algorithms.td3 import TD3OptimizationStepper

from morlnav.data import UniformPreferences
from morlnav.objectives import AngleTerm
from morlnav.transforms import HindsightPreferenceRelabel

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
    loss, batch = make_loss(terms={"angle": AngleTerm(1.0, 1.0)}), make_batch()
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
    loss, batch = make_loss(terms={"angle": AngleTerm(1.0, 1.0)}), make_batch()
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


# Reductions and weights


def test_no_reduction_gives_every_sample_its_loss():
    loss, batch = make_loss(), make_batch()
    loss.reduction = "none"
    actor, critic, _ = slow_losses(loss, batch)
    torch.testing.assert_close(loss.actor_loss(batch)[0], actor)
    torch.testing.assert_close(loss.value_loss(batch)[0], critic)


def test_a_sum_is_a_sum():
    loss, batch = make_loss(), make_batch()
    loss.reduction = "sum"
    torch.testing.assert_close(loss.value_loss(batch)[0], slow_losses(loss, batch)[1].sum())


@pytest.mark.parametrize("setting", ["auto", True])
def test_importance_weights_make_a_weighted_mean(setting):
    loss, batch = make_loss(), make_batch()
    loss.use_prioritized_weights = setting
    actor, critic, _ = slow_losses(loss, batch)
    weight = torch.rand(12) + 0.1
    batch["priority_weight"] = weight
    torch.testing.assert_close(loss.value_loss(batch)[0], (weight * critic).sum() / weight.sum())
    torch.testing.assert_close(loss.actor_loss(batch)[0], (weight * actor).sum() / weight.sum())


def test_importance_weights_can_be_ignored():
    loss, batch = make_loss(), make_batch()
    loss.use_prioritized_weights = False
    batch["priority_weight"] = torch.rand(12)
    torch.testing.assert_close(loss.value_loss(batch)[0], slow_losses(loss, batch)[1].mean())


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


# Mistakes


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"loss_function": "wrong"}, "loss_function must be one of l2, l1, smooth_l1, got wrong"),
    ],
)
def test_wrong_arguments_are_named(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        make_loss(**options)
