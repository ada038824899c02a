"""Configs of the navigation environment, its world and its objectives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from omegaconf import MISSING
from torchrl.trainers.algorithms.configs import EnvConfig

from morlnav.configs.common import PartConfig, store


@store("env", "social_navigation")
@dataclass
class NavigationEnvConfig(PartConfig, EnvConfig):
    """Hydra configuration for :class:`~morlnav.navigation.envs.NavigationEnv`.

    Examples:
        >>> from hydra.utils import instantiate
        >>> instantiate(NavigationEnvConfig(num_envs=4)).batch_size
        torch.Size([4])
    """

    world: Any = None
    scenes: Any = None
    objectives: dict[str, Any] | None = None
    num_envs: int | None = None
    observe_human: bool = True
    seed: int | None = None
    _target_: str = "morlnav.navigation.envs.NavigationEnv"


@store("world", "tensor_world")
@dataclass
class TensorWorldConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.navigation.world.TensorWorld`."""

    robot: Any = None
    lidar: Any = None
    human_radius: float = 0.3
    goal_radius: float = 0.35
    step_time: float = 0.2
    check_interval: float = 0.05
    device: str | None = None
    _target_: str = "morlnav.navigation.world.TensorWorld"


@store("world", "pymunk_world")
@dataclass
class PymunkWorldConfig(TensorWorldConfig):
    """Hydra configuration for :class:`~morlnav.navigation.world.PymunkWorld`."""

    _target_: str = "morlnav.navigation.world.PymunkWorld"


@store("robot", "differential_drive")
@dataclass
class DifferentialDriveConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.navigation.world.DifferentialDrive`."""

    radius: float = 0.18
    max_speed: float = 0.5
    max_turn: float = math.pi
    _target_: str = "morlnav.navigation.world.DifferentialDrive"


@store("lidar", "planar")
@dataclass
class LidarConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.navigation.world.Lidar`."""

    rays: int = 720
    sectors: int = 30
    max_range: float = 4.0
    _target_: str = "morlnav.navigation.world.Lidar"


@store("scenes", "random")
@dataclass
class SceneSamplerConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.navigation.world.SceneSampler`."""

    num_boxes: int = 3
    distance: tuple[float, float] = (6.0, 12.0)
    box_half_side: tuple[float, float] = (0.2, 0.6)
    band: float = 3.0
    clearance: float = 0.6
    human_clearance: float = 0.8
    heading_noise: float = math.pi / 4
    max_tries: int = 50
    _target_: str = "morlnav.navigation.world.SceneSampler"


@store("objective", "goal_progress")
@dataclass
class GoalProgressConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.navigation.envs.GoalProgress`."""

    scale: float = 125.0
    _target_: str = "morlnav.navigation.envs.GoalProgress"


@store("objective", "collision")
@dataclass
class CollisionConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.navigation.envs.Collision`."""

    penalty: float = -1000.0
    _target_: str = "morlnav.navigation.envs.Collision"


@store("objective", "human_distance")
@dataclass
class HumanDistanceConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.navigation.envs.HumanDistance`."""

    penalty: float = -10.0
    threshold: float = 2.0
    minimum: float = 0.3
    _target_: str = "morlnav.navigation.envs.HumanDistance"


@store("objective", "efficiency")
@dataclass
class EfficiencyConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.navigation.envs.Efficiency`."""

    penalty: float = -10.0
    _target_: str = "morlnav.navigation.envs.Efficiency"


@store("objective", "sum")
@dataclass
class SumConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.navigation.envs.Sum`."""

    terms: list[Any] = MISSING
    static: bool = False
    _target_: str = "morlnav.navigation.envs.Sum"


@store("objective", "demonstration")
@dataclass
class DemonstrationObjectiveConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.navigation.envs.DemonstrationObjective`."""

    reward: Any = MISSING
    scale: float = 10.0
    offset: float = -1.0
    observe_human: bool = True
    _target_: str = "morlnav.navigation.envs.DemonstrationObjective"
