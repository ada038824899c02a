"""Cloning regresses in normalised actions: v in m/s and ω in rad/s count alike."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Bounded, Composite

from morlnav.modules import Actor
from morlnav.objectives import BehaviourCloningLoss

LOW, HIGH = torch.tensor([0.0, -torch.pi]), torch.tensor([0.5, torch.pi])


class Constant(nn.Module):
    def __init__(self, *action):
        super().__init__()
        self.action = nn.Parameter(torch.tensor(action))

    def forward(self, observation):
        return self.action.expand(*observation.shape[:-1], -1)


def batch(*actions):
    return TensorDict(
        observation=torch.zeros(len(actions), 34), action=torch.tensor(actions), batch_size=[len(actions)]
    )


def loss_of(module, in_keys=("observation",), **kwargs):
    return BehaviourCloningLoss(TensorDictModule(module, list(in_keys), ["action"]), bounds=(LOW, HIGH), **kwargs)


def test_the_loss_equals_a_value_worked_out_by_hand():
    # errors in half ranges (0.25 m/s, π rad/s): row 1 (1, 0), row 2 (-0.4, 0.5)
    data = batch([0.0, 0.0], [0.35, -torch.pi / 2])
    out = loss_of(Constant(0.25, 0.0))(data)
    torch.testing.assert_close(out["loss_bc"], torch.tensor((1 + 0 + 0.16 + 0.25) / 4))
    torch.testing.assert_close(out["error"], torch.tensor([0.7, 0.25]))
    smooth = loss_of(Constant(0.25, 0.0), loss_function="smooth_l1")(data)["loss_bc"]
    torch.testing.assert_close(smooth, torch.tensor((0.5 + 0 + 0.08 + 0.125) / 4))


def test_one_half_range_of_error_costs_the_same_in_either_entry():
    slow, turned = loss_of(Constant(0.25, 0.0))(batch([0.0, 0.0])), loss_of(Constant(0.0, torch.pi))(batch([0.0, 0.0]))
    torch.testing.assert_close(slow["loss_bc"], turned["loss_bc"])


def test_gradients_reach_the_actor_and_metadata_carries_none():
    module = Constant(0.25, 0.0)
    out = loss_of(module)(batch([0.0, 0.0]))
    out["loss_bc"].backward()
    torch.testing.assert_close(module.action.grad, torch.tensor([1 / 0.25, 0.0]))  # d/dv of mean((v / 0.25)², 0)
    assert not out["error"].requires_grad


def test_an_actor_without_preferences_learns_a_simple_driver():
    torch.manual_seed(0)
    actor = Actor(0, LOW, HIGH, 34, depth=2, num_cells=64)
    loss = loss_of(actor)
    optimizer = torch.optim.Adam(loss.parameters(), 3e-3)
    observation = torch.rand(256, 34) * 2
    action = torch.stack([observation[:, 0] / 4, observation[:, 1].sin()], -1)  # slow down and turn toward the goal
    data = TensorDict(observation=observation, action=action, batch_size=[256])
    before = loss(data)["error"]
    for _ in range(150):
        optimizer.zero_grad()
        loss(data)["loss_bc"].backward()
        optimizer.step()
    assert (loss(data)["error"] < before / 3).all()
    assert torch.equal(actor(observation), actor(observation, torch.rand(256, 3)))  # a clone ignores preferences


def test_keys_masks_reduction_and_specs_can_be_chosen():
    spec = Composite(action=Bounded(LOW.expand(4, 2), HIGH.expand(4, 2)), shape=[4])["action"]
    network = TensorDictModule(Constant(0.25, 0.0), [("robot", "view")], [("robot", "command")])
    loss = BehaviourCloningLoss(network, action_spec=spec, reduction="none")
    loss.set_keys(action=("robot", "command"), pad_mask="padded")
    assert set(loss.in_keys) == {("robot", "view"), ("robot", "command"), "padded"}
    robot = {"view": torch.zeros(2, 34), "command": torch.tensor([[0.0, 0.0], [9.0, 9.0]])}
    out = loss(TensorDict({"robot": robot, "padded": torch.tensor([False, True])}, [2]))
    torch.testing.assert_close(out["loss_bc"], torch.tensor([1.0, 0.0]))
    torch.testing.assert_close(out["error"], torch.tensor([1.0, 0.0]))
    unpadded = loss(TensorDict({"robot": robot}, [2]))["loss_bc"]
    assert unpadded.shape == (2, 2)
    torch.testing.assert_close(unpadded[0], torch.tensor([1.0, 0.0]))


@pytest.mark.parametrize("padding", [1e6, torch.nan, torch.inf])
def test_padding_changes_neither_loss_nor_gradient(padding):
    torch.manual_seed(0)
    actor = Actor(0, LOW, HIGH, 34, depth=1, num_cells=8)
    loss = BehaviourCloningLoss(TensorDictModule(actor, ["observation"], ["action"]), bounds=(LOW, HIGH))
    loss.set_keys(pad_mask="padded")
    padded = torch.arange(5) > torch.tensor([[2], [4], [1]])
    batch = TensorDict(observation=torch.rand(3, 5, 34), action=torch.rand(3, 5, 2), padded=padded, batch_size=[3, 5])
    expected = loss(batch)
    gradient = torch.autograd.grad(expected["loss_bc"], tuple(loss.parameters()))
    for name in ("observation", "action"):
        batch[name][padded] = padding
    out = loss(batch)
    torch.testing.assert_close(out["error"], expected["error"])
    torch.testing.assert_close(torch.autograd.grad(out["loss_bc"], tuple(loss.parameters())), gradient)


def test_one_observation_may_serve_a_chunk_of_actions():
    class Chunk(Constant):
        def forward(self, observation):
            assert observation.isfinite().all()
            return self.action.expand(len(observation), 5, 2)

    padded = torch.arange(5) > torch.tensor([[2], [4], [1]])
    action = torch.zeros(3, 5, 2).masked_fill(padded.unsqueeze(-1), torch.nan)
    loss = loss_of(Chunk(0.25, 0.0))
    loss.set_keys(pad_mask="padded")
    out = loss(TensorDict(observation=torch.rand(3, 34), action=action, padded=padded, batch_size=[3]))
    torch.testing.assert_close(out["error"], torch.tensor([1.0, 0.0]))
    out["loss_bc"].backward()
    assert all(parameter.grad.isfinite().all() for parameter in loss.parameters())


@pytest.mark.parametrize(
    "wrong", [{"loss_function": "l3"}, {"bounds": None}, {"bounds": (HIGH, LOW)}, {"action_spec": Bounded(LOW, HIGH)}]
)
def test_a_wrong_argument_is_named_in_one_sentence(wrong):
    network = TensorDictModule(Constant(0.25, 0.0), ["observation"], ["action"])
    with pytest.raises(ValueError, match=r"^[^\n]*\.$|, got l3\.$"):
        BehaviourCloningLoss(network, **{"bounds": (LOW, HIGH), **wrong})
