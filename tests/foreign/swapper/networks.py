"""What is learned."""

import torch
from torch import nn

from swapper.marks import mark


class Driver(nn.Module):
    def __init__(self, size: int, num_objectives: int, action_low, action_high, cells: int = 8):
        super().__init__()
        self.settings = {"size": size, "num_objectives": num_objectives, "cells": cells}
        self.settings |= {"action_low": list(action_low), "action_high": list(action_high)}
        low, high = torch.tensor(action_low), torch.tensor(action_high)
        self.register_buffer("middle", (low + high) / 2)
        self.register_buffer("reach", (high - low) / 2)
        self.net = nn.Sequential(nn.Linear(size + num_objectives, cells), nn.ReLU(), nn.Linear(cells, len(low)))

    def forward(self, observation, preference=None):
        mark(self)
        seen = observation if preference is None else torch.cat([observation, preference], -1)
        return self.middle + self.reach * self.net(seen).tanh()

    def config(self):
        return self.settings


class Imitator(Driver):
    """The clone: it drives as the driver does, without a preference."""


class Judge(nn.Module):
    def __init__(self, size: int, num_objectives: int, num_rewards: int, action_low, cells: int = 8):
        super().__init__()
        inputs = size + num_objectives + len(action_low)
        self.net = nn.Sequential(nn.Linear(inputs, cells), nn.ReLU(), nn.Linear(cells, num_rewards))

    def forward(self, observation, preference, action):
        mark(self)
        return self.net(torch.cat([observation, preference, action], -1))


class Taste(nn.Module):
    def __init__(self, inputs, size: int):
        super().__init__()
        self.settings, self.net = {"inputs": list(inputs), "size": size}, nn.Linear(size, 1)

    def forward(self, observation, action=None):
        mark(self)
        return self.net(observation).sigmoid().squeeze(-1)

    def config(self):
        return self.settings
