"""Exploration by random actions that are held."""

from __future__ import annotations

from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, exploration_type

from morlnav.modules.noise import EpsilonGreedyNoise


class HeldNoise(TensorDictModuleBase):
    """Explore by :class:`EpsilonGreedyNoise`: at the share ε of all steps a random action acts, held ``hold`` steps.

    Independent noise averages out where an action shows its effect late, as of a car too weak for its hill. It acts
    where exploration is on, and wants TorchRL's ``InitTracker`` in the environment, so that it begins anew with every
    episode.

    Args:
        epsilon_init: ε at the beginning.
        epsilon_end: and at the end.
        hold: steps that a random action lasts.
        annealing_num_steps: calls of ``step`` from the one to the other.
        action_low: least action, length ``A``.
        action_high: largest action, length ``A``.

    Raises:
        ValueError: for a share outside [0, 1], or numbers of steps below 1.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> noise = HeldNoise(epsilon_init=1.0, hold=10, action_low=[-1.0], action_high=[1.0])
        >>> step = TensorDict(action=torch.zeros(3, 1), is_init=torch.ones(3, 1, dtype=torch.bool), batch_size=[3])
        >>> bool((noise(step)["action"] != 0).all())
        True
    """

    in_keys, out_keys = ["action", "is_init"], ["action"]

    def __init__(
        self,
        epsilon_init: float = 0.5,
        epsilon_end: float = 0.1,
        hold: int = 20,
        annealing_num_steps: int = 1000,
        *,
        action_low: Tensor | list[float],
        action_high: Tensor | list[float],
    ) -> None:
        super().__init__()
        if not 0 <= epsilon_end <= 1 or annealing_num_steps < 1:
            raise ValueError(
                f"Needed are 0 <= epsilon_end <= 1 and annealing_num_steps >= 1, got {epsilon_end} and "
                f"{annealing_num_steps}."
            )
        self.noise = EpsilonGreedyNoise(epsilon_init, action_low, action_high, hold)
        self.change = (epsilon_end - epsilon_init) / annealing_num_steps
        self.bounds = sorted((epsilon_init, epsilon_end))

    @property
    def sigma(self) -> Tensor:
        """The present ε, by the name that loggers of exploration look for."""
        return self.noise.epsilon

    def step(self, frames: int = 1) -> None:
        """Anneal by so many steps."""
        self.noise.epsilon.add_(frames * self.change).clamp_(*self.bounds)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Perturb the actions ``[*B, A]`` where exploration is on."""
        if exploration_type() not in (ExplorationType.RANDOM, None):
            return tensordict
        action, is_init = (tensordict.get(key) for key in self.in_keys)
        return tensordict.set("action", self.noise(action, is_init))

    def get_extra_state(self) -> dict[str, Tensor]:
        """What is being held, so that a resumed run goes on holding it."""
        noise = self.noise
        return {} if noise.held is None else {"held": noise.held, "remaining": noise.remaining}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`get_extra_state` returned."""
        self.noise.reset()
        if state:
            self.noise.held, self.noise.remaining = state["held"].clone(), state["remaining"].clone()
            self.noise.is_noisy = self.noise.remaining > 0
