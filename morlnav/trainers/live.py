"""Live objects: what parts get from the environment that a config cannot hold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torchrl.data import Bounded
from torchrl.envs import EnvBase, SerialEnv, StepCounter, TransformedEnv

from morlnav.objectives.bounds import action_bounds
from morlnav.transforms import RewardVector, transforms_of

TOLD = ("rewards", "num_static", "reward_bounds", "max_steps", "live")
"""Attributes by which an environment tells of itself."""


def side_by_side(make: Callable[[], EnvBase], count: int) -> SerialEnv:
    """So many of an environment in TorchRL's ``SerialEnv``, which tell of themselves what one does.

    >>> from morlnav import NavigationEnv
    >>> side_by_side(NavigationEnv, 3).rewards["efficiency"]
    Efficiency(penalty=-10.0)
    """
    env = SerialEnv(count, make)
    env.start()
    for name in TOLD:
        if (values := getattr(env, name, None)) is not None:  # a list, one of each
            setattr(env, name, values[0])
    return env


def live_objects(env: EnvBase) -> dict[str, Any]:
    """What an environment tells the parts that learn in it, by the name of the argument that takes it.

    An environment adds what its own domain needs by an attribute ``live``, as a robot or a lidar's range. One that ends
    episodes by a time limit of its own may tell it by an attribute ``max_steps``.

    Raises:
        ValueError: if actions have no finite bounds, or observations are called otherwise.

    Examples:
        >>> from morlnav import NavigationEnv
        >>> live = live_objects(NavigationEnv(num_envs=2))
        >>> live["num_objectives"], live["rewards"], live["size"]
        (2, ('baseline', 'distance', 'efficiency'), 34)
    """
    base = env.base_env if isinstance(env, TransformedEnv) else env
    vector, spec = RewardVector.of(env), getattr(base, "action_spec_unbatched", base.action_spec)
    low, high = action_bounds(spec, None)
    observed = list(env.observation_spec.keys())
    if "observation" not in observed:
        raise ValueError(f"The environment must write what it observes as 'observation', not {', '.join(observed)}.")
    limits = [each.max_steps for each in transforms_of(env) if isinstance(each, StepCounter)]
    limits = [limit for limit in (*limits, getattr(base, "max_steps", None)) if limit]
    return {
        "rewards": vector.names,
        "objectives": vector.objectives,
        "num_rewards": len(vector.names),
        "num_objectives": len(vector.objectives),
        "num_static": vector.num_static,
        "reward_bounds": vector.bounds,
        "action_spec": Bounded(low, high, shape=low.shape, dtype=spec.dtype, device=env.device),
        "action_low": low.tolist(),
        "action_high": high.tolist(),
        "size": env.observation_spec["observation"].shape[-1],
        **({"max_steps": min(limits)} if limits else {}),
        **getattr(base, "live", {}),
    }
