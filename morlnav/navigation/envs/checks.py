"""What crosses the environment's border: actions on the way in, rewards on the way out."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from morlnav.modules.checks import require
from morlnav.navigation.envs.rewards import Objective, Transition


def check_action(action: Tensor) -> None:
    """Refuse actions ``[B, 2]`` that are not finite; the world would never come back from them.

    Raises:
        ValueError: naming the first of them.

    Examples:
        >>> check_action(torch.tensor([[0.5, 0.0], [torch.nan, 1.0]]))
        Traceback (most recent call last):
        ValueError: Actions must be finite, got v = nan m/s and ω = 1 rad/s for environment 1 of 2.
    """
    finite = action.isfinite()

    def first() -> str:
        row = int((~finite).any(-1).nonzero()[0])
        v, w = action[row].tolist()
        return f"v = {v:.4g} m/s and ω = {w:.4g} rad/s for environment {row} of {len(action)}"

    require(finite.all(), "Actions must be finite", first)


def reward_vector(objectives: Mapping[str, Objective], transition: Transition) -> Tensor:
    """What every objective pays for a transition, ``[B, m]`` of ``float32``; training and evaluation alike.

    An objective returns one reward per environment, ``[B]``; real numbers of any type will do.

    Raises:
        ValueError: for anything else, or a reward that is not finite, by the objective's name.

    Examples:
        >>> from morlnav.navigation.envs.navigation import NavigationEnv
        >>> NavigationEnv(objectives={"odd": lambda transition: 0.0}, num_envs=2).rollout(3)
        Traceback (most recent call last):
        ValueError: The objective odd must return one reward per environment, a tensor [2] of float32 on cpu, got float.
    """
    reward = torch.stack([_checked(name, term(transition), transition.pose) for name, term in objectives.items()], -1)
    finite = reward.isfinite()

    def first() -> str:
        row, column = (~finite).nonzero()[0].tolist()
        return f"{reward[row, column]:.4g} from {list(objectives)[column]} in environment {row} of {len(reward)}"

    require(finite.all(), f"Rewards of the objectives ({', '.join(objectives)}) must be finite", first)
    return reward


def _checked(name: str, reward: object, pose: Tensor) -> Tensor:
    size, device = pose.shape[:1], pose.device
    if not isinstance(reward, Tensor):
        found = type(reward).__name__
    elif reward.shape != size or reward.device != device or reward.is_complex():
        found = f"{list(reward.shape)} of {str(reward.dtype).removeprefix('torch.')} on {reward.device}"
    else:
        return reward.to(torch.float32)
    raise ValueError(
        f"The objective {name} must return one reward per environment, a tensor {list(size)} of float32 on {device}, "
        f"got {found}."
    )
