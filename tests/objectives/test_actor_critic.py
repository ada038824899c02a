"""Keys, parameters, values and targets of the base, tried on the loss that is made of it."""

import copy

import pytest
import torch
from small_losses import ACTION, HIGH, LOW, STATE, Concatenate, gradients, make_batch, make_loss, networks
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Bounded, Composite, LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs.transforms import MultiStepTransform
from torchrl.modules import MLP, TanhModule
from torchrl.objectives import SoftUpdate, ValueEstimators

from morlnav.modules import VectorCritic
from morlnav.objectives import MORLTD3Loss


def test_every_key_can_be_renamed_even_to_nested_ones():
    batch, expected = make_batch(), make_loss()(make_batch())
    torch.manual_seed(0)
    names = {"preference": ("wish", "weights"), "action": ("agent", "move"), "value": "q"}
    actor, critics = networks(3, 2, **names)
    loss = MORLTD3Loss(actor, critics, bounds=(LOW, HIGH), loss_function="l2", policy_noise=0.0)
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
    assert len(out) == len(loss.out_keys) == 6  # no terms here
    torch.testing.assert_close(out[0], loss(batch)["loss_actor"])


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


def test_a_loop_over_critics_gives_the_same_numbers_as_vmap():
    batch, vmap, loop = make_batch(), make_loss(), make_loss()
    loop.deactivate_vmap = True
    loop._make_vmap()
    looped = loop(batch.clone())
    for key, value in vmap(batch.clone()).items():
        torch.testing.assert_close(value, looped[key])


@pytest.mark.parametrize("shape", [(12,), (4, 3)])
def test_stacked_critics_give_the_same_losses_and_gradients_as_vmap(shape):
    torch.manual_seed(0)
    actor = TensorDictModule(Concatenate(STATE + 2, ACTION, nn.Tanh()), ["observation", "preference"], ["action"])
    critics = [VectorCritic(3, 2, LOW, HIGH, STATE, depth=2, num_cells=16) for _ in range(2)]
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


def test_other_value_estimators_are_refused():
    with pytest.raises(NotImplementedError, match="supports TD0 targets"):
        make_loss().make_value_estimator(ValueEstimators.TDLambda)


GAMMAS = {"one discount": 0.9, "one per entry": torch.tensor([0.9, 0.5, 0.99])}


@pytest.mark.parametrize("gamma", GAMMAS.values(), ids=GAMMAS)
def test_what_lies_several_steps_ahead_is_discounted_as_often(gamma):
    loss, batch = make_loss(), make_batch()
    loss.make_value_estimator(gamma=gamma)
    batch["steps_to_next_obs"] = steps = torch.randint(1, 5, (12, 1))
    _, metadata = loss.value_loss(batch)
    ahead = ~batch["next", "terminated"] * metadata["next_state_value"]
    torch.testing.assert_close(metadata["target_value"], batch["next", "reward"] + gamma**steps * ahead)
    assert len(steps.unique()) > 1


def test_torchrls_rewards_of_several_steps_are_learned_from():
    batch, loss, summing = make_batch(count=9), make_loss(), MultiStepTransform(n_steps=3, gamma=0.9)
    batch["next", "done"] = batch["next", "terminated"] = torch.arange(1, 10).view(-1, 1) == 9
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(9), batch_size=64, transform=summing)
    buffer.extend(batch)
    sample = buffer.sample()
    _, metadata = loss.value_loss(sample)
    ahead = 0.9**3 * ~sample["next", "terminated"] * metadata["next_state_value"]
    torch.testing.assert_close(metadata["target_value"], sample["next", "reward"] + ahead)
    assert not sample["next", "terminated"].all()
