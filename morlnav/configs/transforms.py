"""Configs of the transforms of environments and replay buffers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any

from omegaconf import MISSING
from torchrl.envs import Transform
from torchrl.trainers.algorithms.configs.transforms import TransformConfig

from morlnav import transforms
from morlnav.configs.common import PartConfig, store


def _with_nested_keys(transform: type[Transform]) -> Callable[..., Transform]:
    """The constructor, for keys as YAML has them: a list instead of a tuple."""

    @wraps(transform, updated=())
    def make(**arguments: Any) -> Transform:
        keys = {name: tuple(key) for name, key in arguments.items() if name.endswith("_key") and isinstance(key, list)}
        return transform(**arguments | keys)

    return make


make_draw_preference = _with_nested_keys(transforms.DrawPreference)
make_hindsight_preference_relabel = _with_nested_keys(transforms.HindsightPreferenceRelabel)
make_demonstration_reward = _with_nested_keys(transforms.DemonstrationReward)


@store("transform", "draw_preference")
@dataclass
class DrawPreferenceConfig(PartConfig, TransformConfig):
    """Hydra configuration for :class:`~morlnav.transforms.DrawPreference`."""

    sampler: Any = MISSING
    preference_key: Any = "preference"
    _target_: str = "morlnav.configs.transforms.make_draw_preference"


@store("transform", "hindsight_preference_relabel")
@dataclass
class HindsightPreferenceRelabelConfig(PartConfig, TransformConfig):
    """Hydra configuration for :class:`~morlnav.transforms.HindsightPreferenceRelabel`.

    Examples:
        >>> from hydra.utils import instantiate
        >>> from morlnav.configs.data import UniformPreferencesConfig
        >>> instantiate(HindsightPreferenceRelabelConfig(sampler=UniformPreferencesConfig(num_objectives=2))).next_key
        ('next', 'preference')
    """

    sampler: Any = MISSING
    share: float = 1.0
    num_relabels: int = 1
    preference_key: Any = "preference"
    next_key: Any = ("next", "preference")
    _target_: str = "morlnav.configs.transforms.make_hindsight_preference_relabel"


@store("transform", "demonstration_reward")
@dataclass
class DemonstrationRewardConfig(PartConfig, TransformConfig):
    """Hydra configuration for :class:`~morlnav.transforms.DemonstrationReward`."""

    reward_model: Any = MISSING
    scale: float = 10.0
    offset: float = -1.0
    entry: int = 1
    insert: bool = True
    observation_key: Any = "observation"
    action_key: Any = "action"
    reward_key: Any = "reward"
    _target_: str = "morlnav.configs.transforms.make_demonstration_reward"
