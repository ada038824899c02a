"""Configs of the trainer's hooks; what they belong to, such as the loss, they find in the trainer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from omegaconf import MISSING
from torchrl.trainers.algorithms.configs import HookConfig

from morlnav.configs.common import PartConfig, store


@store("hook", "fit_interpolator")
@dataclass
class FitInterpolatorConfig(PartConfig, HookConfig):
    """Hydra configuration for :class:`~morlnav.trainers.FitInterpolator`."""

    env: Any = MISSING
    frames: int = MISSING
    max_steps: int = MISSING
    _target_: str = "morlnav.trainers.FitInterpolator"


@store("hook", "anneal_discount")
@dataclass
class AnnealDiscountConfig(PartConfig, HookConfig):
    """Hydra configuration for :class:`~morlnav.trainers.AnnealDiscount`."""

    start: float = MISSING
    end: Any = MISSING
    frames: int = MISSING
    _target_: str = "morlnav.trainers.AnnealDiscount"


@store("hook", "step_exploration")
@dataclass
class StepExplorationConfig(PartConfig, HookConfig):
    """Hydra configuration for :class:`~morlnav.trainers.StepExploration`."""

    module: Any = None
    _target_: str = "morlnav.trainers.StepExploration"


@store("hook", "log_episodes")
@dataclass
class LogEpisodesConfig(PartConfig, HookConfig):
    """Hydra configuration for :class:`~morlnav.trainers.LogEpisodes`."""

    rewards: list[str] = MISSING
    frames: int = MISSING
    _target_: str = "morlnav.trainers.LogEpisodes"


@store("hook", "log_optimisation")
@dataclass
class LogOptimisationConfig(PartConfig, HookConfig):
    """Hydra configuration for :class:`~morlnav.trainers.LogOptimisation`."""

    rewards: list[str] = MISSING
    frames: int = MISSING
    scalars: Any = None
    _target_: str = "morlnav.trainers.LogOptimisation"


@store("hook", "evaluate_policy")
@dataclass
class EvaluatePolicyConfig(PartConfig, HookConfig):
    """Hydra configuration for :class:`~morlnav.trainers.EvaluatePolicy`; pass live objects to ``instantiate``."""

    policy: Any = MISSING
    env: Any = MISSING
    scenes: Any = MISSING
    preferences: Any = MISSING
    loss: Any = MISSING
    frames: int = MISSING
    max_steps: int = MISSING
    references: Any = None
    _target_: str = "morlnav.trainers.EvaluatePolicy"


@store("hook", "stop_divergence")
@dataclass
class StopDivergenceConfig(PartConfig, HookConfig):
    """Hydra configuration for :class:`~morlnav.trainers.StopDivergence`."""

    _target_: str = "morlnav.trainers.StopDivergence"


@store("hook", "morl_td3_stepper")
@dataclass
class MORLTD3StepperConfig(PartConfig, HookConfig):
    """Hydra configuration for :class:`~morlnav.trainers.MORLTD3Stepper`; pass live objects to ``instantiate``."""

    optimizer_actor: Any = MISSING
    optimizer_critic: Any = MISSING
    target_net_updater: Any = MISSING
    policy_update_delay: int = 2
    actor: Any = None
    average: Any = None
    schedulers: Any = ()
    _target_: str = "morlnav.trainers.MORLTD3Stepper"
