"""What the learner minimises."""

import torch
from torch import nn

from morlnav.objectives import AngleTerm, LossTerm, MORLTD3Loss
from swapper.marks import mark


class StraightLoss(MORLTD3Loss):
    def __init__(self, *args, straight: float = 0.1, **settings):
        super().__init__(*args, **settings)
        self.straight = straight

    def actor_loss(self, tensordict):
        mark(self)
        loss, metadata = super().actor_loss(tensordict)
        action = self.act(tensordict, self.actor_network_params).get(self.tensor_keys.action)
        return loss + self.straight * action[..., 1].square().mean(), metadata


class Weights(nn.Module):
    def forward(self, preference, num_entries):
        mark(self)
        static = preference.new_ones(*preference.shape[:-1], num_entries - preference.shape[-1])
        return torch.cat([static, preference.square()], -1)


class Cosine(AngleTerm):
    def angle(self, a, b):
        mark(self)
        return 1 - (a * b).sum(-1)


class StraightLine(nn.Module):
    def __init__(self, num_static: int = 0):
        super().__init__()
        self.num_static = num_static

    def forward(self, preference):
        mark(self)
        return torch.cat([preference.new_ones(*preference.shape[:-1], self.num_static), preference], -1)


class Effort(LossTerm):
    def actor(self, acted):
        mark(self)
        return 0.01 * acted.action.square().sum(-1)


class Modest(LossTerm):
    def critic(self, judged):
        mark(self)
        return 0.001 * judged.values.square().sum(-1)
