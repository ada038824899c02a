"""An update in the manner of PD-MORL (Basaklar et al., ICLR 2023), written for comparison."""

from __future__ import annotations

import copy
import random

import numpy as np
import torch
from scipy.interpolate import RBFInterpolator
from torch import Tensor, nn
from torch.nn import functional as F


class PDMORL:
    """One environment step's share of the learning: insert a transition four times, sample, interpolate, update.

    What sets it apart, as in the reference implementation: every transition is stored once with its own preference and
    three times with random ones, in a Python list; batches are stacked from single rows; SciPy interpolates the value
    directions of every batch and is refitted about once per episode; both twins carry the angle term in degrees; actor
    and targets move every tenth step.

    Args:
        actor: maps observations and preferences to actions.
        critics: two modules from observations, preferences and actions to vectors of values.
        rows: as for :class:`~benchmarks.peers.minimal_td3.MinimalTD3`.
        low: least action.
        high: largest action.
        batch_size: transitions per update.
    """

    gamma, noise, clip, tau, delay, clip_norm, actor_coefficient = 0.99, 0.2, 0.5, 0.005, 10, 100.0, 10.0
    copies, episode_length = 3, 100

    def __init__(
        self,
        actor: nn.Module,
        critics: list[nn.Module],
        rows: dict[str, Tensor],
        low: Tensor,
        high: Tensor,
        batch_size: int = 256,
    ) -> None:
        self.actor, self.critics = actor, nn.ModuleList(critics)
        self.target_actor, self.target_critics = copy.deepcopy(actor), copy.deepcopy(self.critics)
        self.low, self.high, self.batch_size, self.count = low, high, batch_size, 0
        self.actor_optimizer = torch.optim.Adam(actor.parameters(), lr=3e-4)
        self.critic_optimizer = torch.optim.Adam(self.critics.parameters(), lr=3e-4)
        self.random = np.random.default_rng(0)
        self.num_objectives = rows["reward"].shape[-1]
        self.transitions = list(zip(*(column.cpu().numpy() for column in rows.values()), strict=True))
        self.replay: list[tuple[np.ndarray, ...]] = []
        for transition in self.transitions:
            self._insert(transition)
        self.keys = np.eye(self.num_objectives)
        self.key_values = np.abs(self.random.normal(size=self.keys.shape))
        self._refit()

    def _insert(self, transition: tuple[np.ndarray, ...]) -> None:
        for _ in range(1 + self.copies):
            preference = np.abs(self.random.normal(size=self.num_objectives).astype(np.float32))
            self.replay.append((*transition, preference / preference.sum()))

    def _refit(self) -> None:
        directions = self.key_values / np.linalg.norm(self.key_values, axis=1, keepdims=True)
        self.interpolator = RBFInterpolator(self.keys, directions, kernel="linear")

    def step(self) -> None:
        """Insert one transition and make one update."""
        self.count += 1
        self._insert(self.transitions[self.count % len(self.transitions)])
        if self.count % self.episode_length == 0:
            self._refit()
        batch = random.sample(self.replay, self.batch_size)
        observation, action, reward, following, terminated, preference = (
            torch.as_tensor(np.stack(column)).to(self.low.device) for column in zip(*batch, strict=True)
        )
        direction = torch.as_tensor(self.interpolator(preference.cpu().numpy()), dtype=torch.float32)
        direction = direction.to(self.low.device)
        with torch.no_grad():
            noise = (torch.randn_like(action) * self.noise).clamp(-self.clip, self.clip)
            proposed = self.target_actor(following, preference) + noise * (self.high - self.low) / 2
            proposed = proposed.clamp(self.low, self.high)
            first, second = (critic(following, preference, proposed) for critic in self.target_critics)
            smaller = (preference * first).sum(-1, keepdim=True) < (preference * second).sum(-1, keepdim=True)
            target = reward + self.gamma * (~terminated) * torch.where(smaller, first, second)
        values = [critic(observation, preference, action) for critic in self.critics]
        losses = [_angle(direction, value).mean() + F.smooth_l1_loss(value, target) for value in values]
        self._descend(sum(losses), self.critic_optimizer)
        if self.count % self.delay == 0:
            value = self.critics[0](observation, preference, self.actor(observation, preference))
            loss = -(preference * value).sum(-1) + self.actor_coefficient * _angle(direction, value)
            self._descend(loss.mean(), self.actor_optimizer)
            self._move(self.target_actor, self.actor)
            self._move(self.target_critics, self.critics)

    def _descend(self, loss: Tensor, optimizer: torch.optim.Optimizer) -> None:
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(optimizer.param_groups[0]["params"], self.clip_norm)
        optimizer.step()

    def _move(self, target: nn.Module, source: nn.Module) -> None:
        for old, new in zip(target.parameters(), source.parameters(), strict=True):
            old.data.copy_(self.tau * new.data + (1 - self.tau) * old.data)


def _angle(direction: Tensor, value: Tensor) -> Tensor:
    """Angles in degrees between ``[B, m]`` and ``[B, m]``, with the cosine clamped to [0, 0.9999]."""
    return F.cosine_similarity(direction, value).clamp(0, 0.9999).acos().rad2deg()
