"""Configs of networks, exploration noise, the preference interpolator and the reward models."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from omegaconf import MISSING
from torchrl.trainers.algorithms.configs import TensorDictModuleConfig
from torchrl.trainers.algorithms.configs.modules import NetworkConfig

from morlnav.configs.common import PartConfig, store


@store("network", "navigation_features")
@dataclass
class NavigationFeaturesConfig(PartConfig, NetworkConfig):
    """Hydra configuration for :class:`~morlnav.modules.NavigationFeatures`."""

    observe_human: bool = True
    lidar_range: float = 4.0
    sectors: int = 30
    use_lidar: bool = True
    octaves: int = 0
    _target_: str = "morlnav.modules.NavigationFeatures"


@store("network", "preference_actor")
@dataclass
class ActorConfig(PartConfig, NetworkConfig):
    """Hydra configuration for :class:`~morlnav.modules.Actor`.

    Examples:
        >>> import torch
        >>> from hydra.utils import instantiate
        >>> actor = instantiate(ActorConfig(num_preferences=2, action_low=[0.0, -3.14], action_high=[0.5, 3.14]))
        >>> actor(torch.zeros(7, 34), torch.zeros(7, 2)).shape
        torch.Size([7, 2])
    """

    num_preferences: int = MISSING
    action_low: list[float] = MISSING
    action_high: list[float] = MISSING
    features: Any = None
    depth: int = 4
    num_cells: int = 256
    preference_scale: float = 1.0
    _target_: str = "morlnav.modules.Actor"


@store("network", "vector_critic")
@dataclass
class VectorCriticConfig(PartConfig, NetworkConfig):
    """Hydra configuration for :class:`~morlnav.modules.VectorCritic`."""

    num_objectives: int = MISSING
    num_preferences: int = MISSING
    action_low: list[float] = MISSING
    action_high: list[float] = MISSING
    features: Any = None
    depth: int = 4
    num_cells: int = 256
    preference_scale: float = 1.0
    afterstate: Any = None
    _target_: str = "morlnav.modules.VectorCritic"


@store("network", "afterstate_features")
@dataclass
class AfterstateFeaturesConfig(PartConfig, NetworkConfig):
    """Hydra configuration for :class:`~morlnav.modules.AfterstateFeatures`."""

    robot: Any = None
    step_time: float = 0.2
    observe_human: bool = True
    octaves: int = 4
    lookahead: Any = ()
    _target_: str = "morlnav.modules.AfterstateFeatures"


@store("network", "reward_model")
@dataclass
class RewardModelConfig(PartConfig, NetworkConfig):
    """Hydra configuration for :class:`~morlnav.modules.RewardModel`."""

    inputs: tuple[str, ...] = ("observation", "action")
    action_low: tuple[float, ...] = (0.0, -math.pi)
    action_high: tuple[float, ...] = (0.5, math.pi)
    features: Any = None
    depth: int = 4
    num_cells: int = 256
    in_features: int | None = None
    _target_: str = "morlnav.modules.RewardModel"


@store("network", "reward_ensemble")
@dataclass
class RewardEnsembleConfig(PartConfig, NetworkConfig):
    """Hydra configuration for :class:`~morlnav.modules.RewardEnsemble`."""

    models: list[Any] = MISSING
    reduce: str = "mean"
    _target_: str = "morlnav.modules.RewardEnsemble"


@store("network", "normalised_reward")
@dataclass
class NormalisedRewardConfig(PartConfig, NetworkConfig):
    """Hydra configuration for :class:`~morlnav.modules.NormalisedReward`."""

    model: Any = MISSING
    low: float = 0.0
    high: float = 1.0
    _target_: str = "morlnav.modules.NormalisedReward"


@store("network", "reward_file")
@dataclass
class RewardFileConfig(PartConfig, NetworkConfig):
    """Hydra configuration for :func:`~morlnav.modules.load_reward`: a trained reward model."""

    path: str = MISSING
    device: str = "cpu"
    _target_: str = "morlnav.modules.load_reward"


@dataclass
class OracleConfig(PartConfig, NetworkConfig):
    """What the configs of all oracles share."""

    radius: float = 1.0
    clockwise: bool = True
    speed: float = 0.5
    max_turn: float = math.pi
    step_time: float = 0.2
    sectors: int = 30


@store("network", "circumnavigation_oracle")
@dataclass
class CircumnavigationOracleConfig(OracleConfig):
    """Hydra configuration for :class:`~morlnav.modules.CircumnavigationOracle`."""

    band: float = 0.4
    sector: float = math.pi / 3
    _target_: str = "morlnav.modules.CircumnavigationOracle"


@store("network", "passing_oracle")
@dataclass
class PassingOracleConfig(OracleConfig):
    """Hydra configuration for :class:`~morlnav.modules.PassingOracle`."""

    radius: float = 2.0
    _target_: str = "morlnav.modules.PassingOracle"


@store("network", "slow_passing_oracle")
@dataclass
class SlowPassingOracleConfig(OracleConfig):
    """Hydra configuration for :class:`~morlnav.modules.SlowPassingOracle`."""

    slow: float = 0.2
    reach: float = 2.0
    _target_: str = "morlnav.modules.SlowPassingOracle"


@store("network", "waiting_oracle")
@dataclass
class WaitingOracleConfig(OracleConfig):
    """Hydra configuration for :class:`~morlnav.modules.WaitingOracle`."""

    pause: float = 4.0
    distance: float = 1.8
    depth: float = 0.2
    _target_: str = "morlnav.modules.WaitingOracle"


@store("exploration", "partly_greedy_noise")
@dataclass
class PartlyGreedyNoiseConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.modules.PartlyGreedyNoise`."""

    greedy: float = 0.0
    spec: Any = None
    sigma_init: float = 1.0
    sigma_end: float = 0.1
    annealing_num_steps: int = 1000
    mean: float = 0.0
    std: Any = 1.0
    action_key: Any = "action"
    safe: bool = False
    device: Any = None
    _target_: str = "morlnav.modules.PartlyGreedyNoise"


@store("exploration", "epsilon_greedy_noise")
@dataclass
class EpsilonGreedyNoiseConfig(PartConfig, NetworkConfig):
    """Hydra configuration for :class:`~morlnav.modules.EpsilonGreedyNoise`."""

    epsilon: Any = MISSING
    action_low: list[float] = MISSING
    action_high: list[float] = MISSING
    hold: int = 1
    generator: Any = None
    _target_: str = "morlnav.modules.EpsilonGreedyNoise"


@store("exploration", "wandering_noise")
@dataclass
class WanderingNoiseConfig(PartConfig, NetworkConfig):
    """Hydra configuration for :class:`~morlnav.modules.WanderingNoise`."""

    epsilon: Any = MISSING
    action_low: list[float] = MISSING
    action_high: list[float] = MISSING
    hold: int = 10
    courses: float = 0.5
    spread: float = 1.0
    step_time: float = 0.2
    generator: Any = None
    _target_: str = "morlnav.modules.WanderingNoise"


@store("interpolator", "preference")
@dataclass
class PreferenceInterpolatorConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.modules.PreferenceInterpolator`."""

    num_objectives: int = MISSING
    num_static: int = 1
    preferences: Any = None
    values: Any = None
    steps: int = 10
    decay: float = 1.0
    weights: Any = None
    _target_: str = "morlnav.modules.PreferenceInterpolator"


@store("model", "preference_actor")
@dataclass
class PreferenceActorModelConfig(TensorDictModuleConfig):
    """A policy as the trainers want it: any network (``module``) on an observation and a preference."""

    module: Any = MISSING
    in_keys: Any = field(default_factory=partial(list, ("observation", "preference")))
    out_keys: Any = field(default_factory=partial(list, ("action",)))


@store("model", "vector_critic")
@dataclass
class VectorCriticModelConfig(TensorDictModuleConfig):
    """A critic as :class:`~morlnav.objectives.MORLTD3Loss` wants it: any network (``module``) to a vector of values."""

    module: Any = MISSING
    in_keys: Any = field(default_factory=partial(list, ("observation", "preference", "action")))
    out_keys: Any = field(default_factory=partial(list, ("state_action_value",)))


@store("exploration", "noise")
@dataclass
class NoiseModelConfig(TensorDictModuleConfig):
    """Noise (``module``) on the policy's actions; needs TorchRL's ``InitTracker`` in the environment."""

    module: Any = MISSING
    in_keys: Any = field(default_factory=partial(list, ("action", "is_init", "observation")))
    out_keys: Any = field(default_factory=partial(list, ("action",)))
