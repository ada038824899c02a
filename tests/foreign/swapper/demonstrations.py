"""What is learned from."""

import torch
from torch import nn

from morlnav.navigation.demonstrations import RecordedPolicy
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.trainers import Cloning, Ranking
from swapper.marks import mark


class Films(RecordedPolicy):
    def collect(self, num):
        mark(self)
        return super().collect(num)


class Guide(CircumnavigationOracle):
    def __call__(self, observation):
        mark(self)
        return super().__call__(observation)


class Wobble(nn.Module):
    def __init__(self, epsilon):
        super().__init__()
        self.epsilon = epsilon

    def forward(self, action, is_init, observation):
        mark(self)
        return action + self.epsilon.unsqueeze(-1) * torch.randn_like(action)


class Copying(Cloning):
    def __call__(self, data, live, **display):
        mark(self)
        return super().__call__(data, live, **display)


class Contest(Ranking):
    def __call__(self, rollouts, live, **display):
        mark(self)
        return super().__call__(rollouts, live, **display)
