"""The hand-written TD3 update for several seeds at once: their parameters are stacked, and ``vmap`` runs over them."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn
from torch.func import functional_call, grad, stack_module_state, vmap
from torch.nn import functional as F

from benchmarks.peers.minimal_td3 import MinimalTD3

Params = dict[str, Tensor]


class StackedTD3(MinimalTD3):
    """One update of every seed, as ``MinimalTD3`` makes them one after the other, with its constants.

    Args:
        actors: one per seed.
        critics: per seed two modules that take stacked parameters, such as :class:`~morlnav.modules.VectorCritic`.
        rows: transitions ``[N, ...]``, as of ``MinimalTD3``; every seed draws batches of its own.
        low: least action.
        high: largest action.
        num_preferences: entries of λ.
        batch_size: transitions per update and seed.
        delay: updates of the critics per update of the actor.
    """

    def __init__(
        self,
        actors: list[nn.Module],
        critics: list[list[nn.Module]],
        rows: dict[str, Tensor],
        low: Tensor,
        high: Tensor,
        num_preferences: int,
        batch_size: int = 256,
        delay: int = 2,
    ) -> None:
        self.networks = copy.deepcopy(actors[0]), copy.deepcopy(critics[0][0])
        self.actor, _ = stack_module_state(actors)
        twins = [stack_module_state(pair)[0] for pair in critics]
        self.critics = {name: torch.stack([twin[name].detach() for twin in twins]) for name in twins[0]}
        for parameter in self.critics.values():
            parameter.requires_grad_()
        self.target_actor, self.target_critics = (
            {name: value.detach().clone() for name, value in params.items()} for params in (self.actor, self.critics)
        )
        self.rows, self.low, self.high = rows, low, high
        self.num_preferences, self.batch_size, self.delay, self.count = num_preferences, batch_size, delay, 0
        self.actor_optimizer = torch.optim.Adam(self.actor.values(), lr=3e-4, fused=True)
        self.critic_optimizer = torch.optim.Adam(self.critics.values(), lr=3e-4, fused=True)

    def step(self) -> None:
        """One update of every seed."""
        self.count += 1
        size = (len(next(iter(self.actor.values()))), self.batch_size)
        index = torch.randint(len(self.rows["reward"]), size, device=self.low.device)
        batch = {name: column[index] for name, column in self.rows.items()}
        preference = torch.rand(*size, self.num_preferences, device=self.low.device).log()
        batch["preference"] = preference / preference.sum(-1, keepdim=True)
        noise = torch.randn_like(batch["action"]).mul_(self.noise).clamp_(-self.clip, self.clip)
        batch["noise"] = noise * (self.high - self.low) / 2
        gradients = vmap(grad(self._critic_loss))(self.critics, self.target_critics, self.target_actor, batch)
        self._descend(self.critics, gradients, self.critic_optimizer)
        if self.count % self.delay == 0:
            gradients = vmap(grad(self._actor_loss))(self.actor, self.critics, batch)
            self._descend(self.actor, gradients, self.actor_optimizer)
            targets = [*self.target_actor.values(), *self.target_critics.values()]
            with torch.no_grad():
                torch._foreach_lerp_(targets, [*self.actor.values(), *self.critics.values()], self.tau)

    def _act(self, actor: Params, observation: Tensor, preference: Tensor) -> Tensor:
        return functional_call(self.networks[0], actor, (observation, preference))

    def _values(self, critics: Params, observation: Tensor, preference: Tensor, action: Tensor) -> Tensor:
        return functional_call(self.networks[1], critics, (observation, preference, action))

    def _weights(self, batch: dict[str, Tensor]) -> Tensor:
        return F.pad(batch["preference"], (batch["reward"].shape[-1] - self.num_preferences, 0), value=1.0)

    def _critic_loss(self, critics: Params, target_critics: Params, actor: Params, batch: dict[str, Tensor]) -> Tensor:
        preference, following = batch["preference"], batch["next_observation"]
        action = (self._act(actor, following, preference) + batch["noise"]).clamp(self.low, self.high)
        first, second = self._values(target_critics, following, preference, action)
        smaller = ((first - second) * self._weights(batch)).sum(-1, keepdim=True) < 0
        target = batch["reward"] + self.gamma * ~batch["terminated"] * torch.where(smaller, first, second)
        values = self._values(critics, batch["observation"], preference, batch["action"])
        return (values - target).square().sum(-1).mean(-1).sum()

    def _actor_loss(self, actor: Params, critics: Params, batch: dict[str, Tensor]) -> Tensor:
        observation, preference = batch["observation"], batch["preference"]
        first = {name: value[0] for name, value in critics.items()}
        value = self._values(first, observation, preference, self._act(actor, observation, preference))
        return -(self._weights(batch) * value).sum(-1).mean()

    def _descend(self, params: Params, gradients: Params, optimizer: torch.optim.Optimizer) -> None:
        squares = sum(gradient.flatten(1).square().sum(1) for gradient in gradients.values())
        factor = (self.clip_norm / (squares.sqrt() + 1e-6)).clamp_max(1.0)  # every seed's own
        for name, gradient in gradients.items():
            # The fused optimizer wants the parameter's memory layout, which vmap does not keep.
            params[name].grad = (gradient * factor.view(-1, *[1] * (gradient.ndim - 1))).contiguous()
        optimizer.step()
        optimizer.zero_grad()
