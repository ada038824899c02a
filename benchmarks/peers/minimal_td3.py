"""A TD3 update as one would write it by hand: plain PyTorch, nothing but the algorithm."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class MinimalTD3:
    """One update: sample, relabel, critics, and at every ``delay``-th step the actor and the targets.

    The same networks and the same work as ``MORLTD3Loss`` without angle and guidance; no averaged actor, no learning
    rate schedule, no logging.

    Args:
        actor: maps observations and preferences to actions.
        critics: two modules from observations, preferences and actions to vectors of values.
        rows: ``observation``, ``action``, ``reward``, ``next_observation`` and ``terminated``, each ``[N, ...]``.
        low: least action.
        high: largest action.
        num_preferences: entries of λ; the other entries of the reward have the weight 1.
        batch_size: transitions per update.
        delay: updates of the critics per update of the actor.
    """

    gamma, noise, clip, tau, clip_norm = 0.99, 0.2, 0.5, 0.005, 10.0

    def __init__(
        self,
        actor: nn.Module,
        critics: list[nn.Module],
        rows: dict[str, Tensor],
        low: Tensor,
        high: Tensor,
        num_preferences: int,
        batch_size: int = 256,
        delay: int = 2,
    ) -> None:
        self.actor, self.critics = actor, nn.ModuleList(critics)
        self.target_actor, self.target_critics = copy.deepcopy(actor), copy.deepcopy(self.critics)
        self.rows, self.low, self.high = rows, low, high
        self.num_preferences, self.batch_size, self.delay, self.count = num_preferences, batch_size, delay, 0
        self.actor_optimizer = torch.optim.Adam(actor.parameters(), lr=3e-4, fused=True)
        self.critic_optimizer = torch.optim.Adam(self.critics.parameters(), lr=3e-4, fused=True)

    def step(self) -> None:
        """One update."""
        self.count += 1
        index = torch.randint(len(self.rows["reward"]), (self.batch_size,), device=self.low.device)
        batch = {name: column[index] for name, column in self.rows.items()}
        observation, reward, following = batch["observation"], batch["reward"], batch["next_observation"]
        preference = torch.rand(self.batch_size, self.num_preferences, device=self.low.device).log()
        preference = preference / preference.sum(-1, keepdim=True)  # uniform on the simplex
        weights = F.pad(preference, (reward.shape[-1] - self.num_preferences, 0), value=1.0)
        with torch.no_grad():
            noise = torch.randn_like(batch["action"]).mul_(self.noise).clamp_(-self.clip, self.clip)
            action = self.target_actor(following, preference) + noise * (self.high - self.low) / 2
            action = action.clamp(self.low, self.high)
            first, second = (critic(following, preference, action) for critic in self.target_critics)
            smaller = ((first - second) * weights).sum(-1, keepdim=True) < 0
            target = reward + self.gamma * ~batch["terminated"] * torch.where(smaller, first, second)
        values = [critic(observation, preference, batch["action"]) for critic in self.critics]
        self._descend(sum((value - target).square().sum(-1).mean() for value in values), self.critic_optimizer)
        if self.count % self.delay == 0:
            self.critics.requires_grad_(False)
            value = self.critics[0](observation, preference, self.actor(observation, preference))
            self._descend(-(weights * value).sum(-1).mean(), self.actor_optimizer)
            self.critics.requires_grad_(True)
            targets = [*self.target_actor.parameters(), *self.target_critics.parameters()]
            with torch.no_grad():
                torch._foreach_lerp_(targets, [*self.actor.parameters(), *self.critics.parameters()], self.tau)

    def _descend(self, loss: Tensor, optimizer: torch.optim.Optimizer) -> None:
        loss.backward()
        nn.utils.clip_grad_norm_(optimizer.param_groups[0]["params"], self.clip_norm)
        optimizer.step()
        optimizer.zero_grad()
