"""The demonstration objective: any learned reward as one entry of the reward vector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from morlnav.navigation.envs.rewards import Transition, check_finite
from morlnav.navigation.world import without_human


@dataclass(frozen=True)
class DemonstrationObjective:
    """``scale·(R̂(s_t, a_t) + offset)``, how much a step looks like the demonstration (Sec. III-D.3).

    With ``R̂`` in [0, 1] and the default offset the reward lies in [-10, 0], like the other styles. The printed form is
    ``offset=1.0``; it pays 10 to 20 for every step, hence for dawdling.

    Args:
        reward: maps observations ``[B, 34]`` and actions ``[B, 2]`` to ``R̂`` ``[B]``, such as a loaded reward model;
            called without gradients.
        scale: the factor ``c_d``.
        offset: added to ``R̂``.
        observe_human: whether ``reward`` sees the human's position; without, it gets ``[B, 32]`` (``-NH`` ablation).

    Raises:
        ValueError: unless ``scale`` and ``offset`` are finite numbers.

    Examples:
        >>> from morlnav.navigation.envs.navigation import NavigationEnv
        >>> from morlnav.navigation.envs.rewards import Efficiency
        >>> slow = lambda observation, action: 1 - action[:, 0] / 0.5
        >>> objectives = {"demo": DemonstrationObjective(slow), "efficiency": Efficiency()}
        >>> env = NavigationEnv(objectives=objectives, num_envs=3)
        >>> reward = env.rollout(2)["next", "reward"][..., 0]
        >>> bool(((reward >= -10) & (reward <= 0)).all())
        True
    """

    reward: Callable[[Tensor, Tensor], Tensor]
    scale: float = 10.0
    offset: float = -1.0
    observe_human: bool = True

    def __post_init__(self) -> None:
        check_finite(self)

    @torch.no_grad()
    def __call__(self, transition: Transition) -> Tensor:
        """Reward ``[B]``."""
        observation = transition.observation
        if not self.observe_human:
            observation = without_human(observation)
        return self.scale * (self.reward(observation, transition.action) + self.offset)

    def bounds(self, reach: float) -> tuple[float, float]:
        """Least and largest reward of a step, for ``R̂`` in [0, 1]."""
        ends = self.scale * self.offset, self.scale * (1 + self.offset)
        return min(ends), max(ends)
