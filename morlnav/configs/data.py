"""Configs of the preference samplers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from omegaconf import MISSING

from morlnav.configs.common import PartConfig, store


@store("preference_sampler", "uniform")
@dataclass
class UniformPreferencesConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.data.UniformPreferences`.

    Examples:
        >>> from hydra.utils import instantiate
        >>> instantiate(UniformPreferencesConfig(num_objectives=3))(5).shape
        torch.Size([5, 3])
    """

    num_objectives: int = MISSING
    _target_: str = "morlnav.data.UniformPreferences"


@store("preference_sampler", "dirichlet")
@dataclass
class DirichletPreferencesConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.data.DirichletPreferences`."""

    num_objectives: int = MISSING
    concentration: Any = 1.0
    _target_: str = "morlnav.data.DirichletPreferences"


@store("preference_sampler", "corner_weighted")
@dataclass
class CornerWeightedPreferencesConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.data.CornerWeightedPreferences`."""

    num_objectives: int = MISSING
    corner: float = 0.2
    edge: float = 0.3
    _target_: str = "morlnav.data.CornerWeightedPreferences"


@store("preference_sampler", "segmented")
@dataclass
class SegmentedPreferencesConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.data.SegmentedPreferences`."""

    num_objectives: int = MISSING
    segments: int = MISSING
    offset: int = 0
    _target_: str = "morlnav.data.SegmentedPreferences"


@store("preference_sampler", "grid")
@dataclass
class GridPreferencesConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.data.GridPreferences`."""

    num_objectives: int = MISSING
    steps: int = MISSING
    _target_: str = "morlnav.data.GridPreferences"


@store("preference_sampler", "fixed")
@dataclass
class FixedPreferencesConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.data.FixedPreferences`."""

    value: list[float] = MISSING
    num_objectives: int | None = None
    _target_: str = "morlnav.data.FixedPreferences"
