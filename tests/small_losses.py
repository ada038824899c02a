"""A small actor, small critics, batches and a loss, and the loss's equations as a slow loop."""

import math

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.nn.functional import l1_loss, mse_loss, smooth_l1_loss
from torchrl.modules import MLP
from torchrl.objectives import ValueEstimators

from morlnav.data import UniformPreferences
from morlnav.objectives import MORLTD3Loss

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
    """A loss whose targets differ from its networks; the same seed gives the same weights."""
    torch.manual_seed(options.pop("seed", 0))
    actor, critics = networks(m, n)
    options = {"bounds": (LOW, HIGH), "loss_function": "l2", "policy_noise": 0.0, **options}
    loss = MORLTD3Loss(actor, critics, **options)
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.9)
    with torch.no_grad():
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


def slow_losses(loss, batch, gamma=0.9, distance="l2", angle=(0.0, 0.0), direction=None):
    """Actor and critic losses per sample, and targets, by loops over everything; ``angle`` are its coefficients."""
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
            critic = critic + angle[1] * angle_between(lam_p, value)
        critic_losses.append(critic)

        action = call(loss, "actor_network", loss.actor_network_params, sample["observation"], lam)
        value = call(loss, "qvalue_network", q[0], sample["observation"], lam, action)
        actor_losses.append(-(w @ value) + angle[0] * angle_between(lam_p, value))
    return torch.stack(actor_losses).detach(), torch.stack(critic_losses).detach(), torch.stack(targets)


def gradients(params):
    return [tensor.grad for tensor in params.values(True, True) if tensor.grad is not None]


def value_of(loss, batch, action, critic=0):
    """Value vectors of one critic for other actions."""
    with loss.qvalue_network_params.detach()[critic].to_module(loss.qvalue_network):
        return loss.qvalue_network(batch.clone().set("action", action))["state_action_value"]


def action_of(loss, batch):
    with loss.actor_network_params.to_module(loss.actor_network):
        return loss.actor_network(batch.clone())["action"]
