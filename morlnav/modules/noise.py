"""Noise on actions: of exploration, and for ranked roll-outs, where random actions may be held."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.modules import AdditiveGaussianModule

from morlnav.limits import check_at_least
from morlnav.modules.networks import ActionBounds


class PartlyGreedyNoise(AdditiveGaussianModule):
    """TorchRL's additive Gaussian noise on the actions of some environments of the batch; the others act greedily.

    A deterministic policy may come to rest where any noise would help it on, such as before an obstacle that it can
    pass on either side: noisy roll-outs never show that, and what they do not show is not unlearned. Environments that
    explore to different degrees are as in Ape-X (Horgan et al. 2018).

    Args:
        greedy: share of the environments (the last batch dimension) without noise, in [0, 1], spread evenly.
        spec: of the action, whose bounds are kept.
        sigma_init: factor of the noise at the beginning.
        sigma_end: and at the end.
        std: of the noise, one number or one per action ``[A]``.
        **settings: all else that ``AdditiveGaussianModule`` takes, such as ``annealing_num_steps``.

    Raises:
        ValueError: if ``greedy`` is no share, or the factor of the noise rises or is negative.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Bounded
        >>> noise = PartlyGreedyNoise(greedy=0.5, spec=Bounded(-1.0, 1.0, shape=(1,)))
        >>> (noise(TensorDict(action=torch.zeros(4, 1), batch_size=[4]))["action"] == 0).flatten()
        tensor([False,  True, False,  True])
    """

    def __init__(
        self,
        greedy: float = 0.5,
        spec: TensorSpec | None = None,
        sigma_init: float = 0.3,
        sigma_end: float = 0.1,
        *,
        std: float | Sequence[float] = 1.0,
        **settings: Any,
    ) -> None:
        if not 0 <= sigma_end <= sigma_init:
            raise ValueError(f"sigma_init and sigma_end must fall, 0 <= end <= init, got {sigma_init} and {sigma_end}.")
        super().__init__(spec, sigma_init, sigma_end, std=std, **settings)
        if not 0 <= greedy <= 1:
            raise ValueError(f"greedy must be a share between 0 and 1, got {greedy}.")
        self.greedy = greedy

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Adds noise to the action where exploration is on."""
        clean = tensordict.get(self.action_key)
        tensordict = super().forward(tensordict)
        if not self.greedy or clean.ndim < 2:
            return tensordict
        count = (self.greedy * torch.arange(clean.shape[-2] + 1, device=clean.device)).floor().diff()
        noisy = tensordict.get(self.action_key)
        return tensordict.set(self.action_key, torch.where(count.bool().unsqueeze(-1), clean, noisy))


class EpsilonGreedyNoise(ActionBounds):
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
        super().__init__(action_low, action_high)
        epsilon = torch.as_tensor(epsilon, dtype=torch.float32)
        if not ((epsilon >= 0) & (epsilon <= 1)).all():
            raise ValueError(f"epsilon must be between 0 and 1, got {epsilon.tolist()}.")
        check_at_least(1, hold=hold)
        self.register_buffer("epsilon", epsilon)
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
        return lambda observation, *inputs: self(policy(observation, *inputs), observation=observation)

    @torch.no_grad()
    def forward(self, action: Tensor, is_init: Tensor | None = None, observation: Tensor | None = None) -> Tensor:
        """Perturb one step's actions.

        Args:
            action: the policy's actions ``[*B, A]``.
            is_init: ``bool`` ``[*B]`` or ``[*B, 1]``, true where an episode begins; all do at the first call.
            observation: what the policy saw ``[*B, D]``; plain random actions do not depend on it.

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
        drawn = self._draw(batch)

        self.held = drawn if self.held is None else torch.where(started.unsqueeze(-1), drawn, self.held)
        self.remaining = torch.where(started, left, torch.where(first, 0, self.remaining))
        self.is_noisy = self.remaining > 0
        self.remaining = (self.remaining - 1).clamp_min(0)
        noise = self._act(self.held, observation).to(action.dtype)
        return torch.where(self.is_noisy.unsqueeze(-1), noise, action)

    def _draw(self, batch: torch.Size) -> Tensor:
        """What is held from now on, ``[*B, K]``."""
        return self.low + self._rand(*batch, len(self.low)) * (self.high - self.low)

    def _act(self, held: Tensor, observation: Tensor | None) -> Tensor:
        """The action ``[*B, A]`` that the held values stand for."""
        return held

    def _first(self, batch: torch.Size, is_init: Tensor | None) -> Tensor:
        """Where an episode begins, ``[*B]``; sets the state up at the first call."""
        if self.remaining is None:
            if self.epsilon.ndim and self.epsilon.shape != batch:
                raise ValueError(f"Got {list(self.epsilon.shape)} values of epsilon for actions of {list(batch)}.")
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
