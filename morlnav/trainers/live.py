"""Live objects: what parts get from the environment that a config cannot hold."""

from __future__ import annotations

from typing import Any

from torchrl.data import Bounded
from torchrl.envs import EnvBase, StepCounter, TransformedEnv

from morlnav.objectives.bounds import action_bounds
from morlnav.transforms import RewardVector, transforms_of


def live_objects(env: EnvBase) -> dict[str, Any]:
    """What an environment tells the parts that learn in it, by the name of the argument that takes it.

    An environment adds what its own domain needs by an attribute ``live``, as a robot or a lidar's range.

    Raises:
        ValueError: if actions have no finite bounds.

    Examples:
        >>> from morlnav import NavigationEnv
        >>> live = live_objects(NavigationEnv(num_envs=2))
        >>> live["num_objectives"], live["rewards"], live["size"]
        (2, ('baseline', 'distance', 'efficiency'), 34)
    """
    base = env.base_env if isinstance(env, TransformedEnv) else env
    vector, spec = RewardVector.of(env), getattr(base, "action_spec_unbatched", base.action_spec)
    low, high = action_bounds(spec, None)
    limits = [transform for transform in transforms_of(env) if isinstance(transform, StepCounter)]
    return {
        "rewards": vector.names,
        "objectives": vector.objectives,
        "num_rewards": len(vector.names),
        "num_objectives": vector.num_objectives,
        "num_static": vector.num_static,
        "reward_bounds": vector.bounds,
        "action_spec": Bounded(low, high, shape=low.shape, dtype=spec.dtype, device=env.device),
        "action_low": low.tolist(),
        "action_high": high.tolist(),
        "size": env.observation_spec["observation"].shape[-1],
        **({"max_steps": limits[0].max_steps} if limits else {}),
        **getattr(base, "live", {}),
    }
