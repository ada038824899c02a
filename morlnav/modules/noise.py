"""Epsilon-greedy noise that may hold its random actions, for ranked roll-outs."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn


class EpsilonGreedyNoise(nn.Module):
    """Replace the share ``ε`` of a policy's actions by uniformly random ones, each held ``hold`` steps (Sec. III-C).

    ``hold=1`` draws independently at every step, as printed. Such noise hardly moves the robot and shows in the action
    alone; held for about two seconds (10 steps) it leads the robot astray, which is what ranked roll-outs are to show.

    A free step starts a random action with probability ``ε / (ε + hold·(1 - ε))``. An episode's first step is drawn
    from the stationary state, as if the noise had always been running, so the expected share of noisy steps is exactly
    ``ε`` at every step, however short the episode.

    The module perturbs actions and knows no policy. It keeps one state per environment:

    * In a ``TensorDictSequential``, for a collector or ``env.rollout``, put
      ``TensorDictModule(noise, ["action", "is_init"], ["action"])`` behind the policy and ``InitTracker`` into the
      environment: every environment then begins anew with its episode. It acts under any ``ExplorationType``.
    * As a plain ``policy(observation, preference)``, take :meth:`around`. Finished episodes must then stay in the
      batch: ``evaluate_policy(noise.around(policy), ..., drop_finished=False)``.

    Args:
        epsilon: share of noisy steps in [0, 1]; a number, or one per environment, ``[*B]``, so that all noise levels
            roll out side by side.
        action_low: least action, length ``A``.
        action_high: largest action, length ``A``.
        hold: steps that a random action lasts.
        generator: source of randomness; torch's global state by default.

    Attributes:
        is_noisy: which environments' last action was random, ``bool`` ``[*B]``; ``None`` before the first call.

    Raises:
        ValueError: if ``epsilon`` is not in [0, 1] or ``hold`` is below 1.

    Examples:
        >>> noise = EpsilonGreedyNoise(torch.tensor([0.0, 0.5, 1.0]), [0.0, -3.14], [0.5, 3.14], hold=10)
        >>> noise(torch.zeros(3, 2)).shape
        torch.Size([3, 2])
        >>> noise.is_noisy[[0, 2]]
        tensor([False,  True])
    """

    def __init__(
        self,
        epsilon: float | Tensor,
        action_low: Tensor | list[float],
        action_high: Tensor | list[float],
        hold: int = 1,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        epsilon = torch.as_tensor(epsilon, dtype=torch.float32)
        if not ((epsilon >= 0) & (epsilon <= 1)).all():
            raise ValueError(f"epsilon must be between 0 and 1, got {epsilon.tolist()}.")
        if hold < 1:
            raise ValueError(f"hold must be at least 1 step, got {hold}.")
        self.register_buffer("epsilon", epsilon)
        self.register_buffer("low", torch.as_tensor(action_low, dtype=torch.float32))
        self.register_buffer("high", torch.as_tensor(action_high, dtype=torch.float32))
        self.hold = hold
        self.generator = generator
        self.reset()

    def reset(self) -> None:
        """Begin new episodes in every environment, of any number, at the next call."""
        self.held: Tensor | None = None
        self.remaining: Tensor | None = None
        self.is_noisy: Tensor | None = None

    def around(self, policy: Callable[..., Tensor]) -> Callable[..., Tensor]:
        """The noisy ``policy`` as a plain callable on whatever the policy takes; begins new episodes."""
        self.reset()
        return lambda *inputs: self(policy(*inputs))

    @torch.no_grad()
    def forward(self, action: Tensor, is_init: Tensor | None = None) -> Tensor:
        """Perturb one step's actions.

        Args:
            action: the policy's actions ``[*B, A]``.
            is_init: ``bool`` ``[*B]`` or ``[*B, 1]``, true where an episode begins; all do at the first call.

        Returns:
            The policy's or the held random actions, ``[*B, A]``.

        Raises:
            ValueError: if the batch changed since the last call, or does not fit ``epsilon``.
        """
        batch = action.shape[:-1]
        first = self._first(batch, is_init)
        epsilon = self.epsilon.expand(batch)
        free = epsilon / (epsilon + self.hold * (1 - epsilon))
        chance = torch.where(first, epsilon, torch.where(self.remaining == 0, free, 0.0))
        started = self._rand(*batch) < chance
        left = torch.where(first, (self._rand(*batch) * self.hold).long() + 1, self.hold)
        drawn = self.low + self._rand(*action.shape) * (self.high - self.low)

        self.held = torch.where(started.unsqueeze(-1), drawn, self.held)
        self.remaining = torch.where(started, left, torch.where(first, 0, self.remaining))
        self.is_noisy = self.remaining > 0
        self.remaining = (self.remaining - 1).clamp_min(0)
        return torch.where(self.is_noisy.unsqueeze(-1), self.held.to(action.dtype), action)

    def _first(self, batch: torch.Size, is_init: Tensor | None) -> Tensor:
        """Where an episode begins, ``[*B]``; sets the state up at the first call."""
        if self.remaining is None:
            if self.epsilon.ndim and self.epsilon.shape != batch:
                raise ValueError(f"Got {list(self.epsilon.shape)} values of epsilon for actions of {list(batch)}.")
            self.held = self.low.expand(*batch, -1)
            self.remaining = self.epsilon.new_zeros(batch, dtype=torch.long)
            return torch.ones_like(self.remaining, dtype=torch.bool)
        if self.remaining.shape != batch:
            raise ValueError(
                f"The noise is amid episodes of {list(self.remaining.shape)} environments and got actions of "
                f"{list(batch)}; keep finished episodes in the batch (drop_finished=False), or call reset()."
            )
        return torch.zeros_like(self.is_noisy) if is_init is None else is_init.reshape(batch)

    def _rand(self, *shape: int) -> Tensor:
        if self.generator is None:
            return torch.rand(shape, device=self.low.device)
        return torch.rand(shape, generator=self.generator, device=self.generator.device).to(self.low.device)
