"""Configs of the losses and of what they are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from omegaconf import MISSING
from torchrl.trainers.algorithms.configs import LossConfig

from morlnav.configs.common import PartConfig, store


@store("loss", "multi_objective_td3")
@dataclass
class MORLTD3LossConfig(PartConfig, LossConfig):
    """Hydra configuration for :class:`~morlnav.objectives.MORLTD3Loss`.

    Partial by default: TorchRL's ``TD3Trainer`` puts networks and action bounds in.
    """

    actor_network: Any = MISSING
    qvalue_network: Any = MISSING
    action_spec: Any = None
    bounds: Any = None
    num_qvalue_nets: int = 2
    actor_qvalue_nets: int = 1
    policy_noise: float = 0.2
    noise_clip: float = 0.5
    loss_function: str = "smooth_l1"
    pessimism: float = 1.0
    scalarisation: Any = None
    terms: Any = None
    reward_bounds: Any = None
    _partial_: bool = True
    _target_: str = "morlnav.objectives.MORLTD3Loss"


@store("loss", "behaviour_cloning")
@dataclass
class BehaviourCloningLossConfig(PartConfig, LossConfig):
    """Hydra configuration for :class:`~morlnav.objectives.BehaviourCloningLoss`."""

    actor_network: Any = MISSING
    action_spec: Any = None
    bounds: Any = None
    loss_function: str = "l2"
    reduction: str | None = None
    _target_: str = "morlnav.objectives.BehaviourCloningLoss"


@store("loss", "ranking")
@dataclass
class RankingLossConfig(PartConfig, LossConfig):
    """Hydra configuration for :class:`~morlnav.objectives.RankingLoss`."""

    reward_network: Any = MISSING
    aggregate: str = "mean"
    temperature: float = 10.0
    reduction: str | None = None
    _target_: str = "morlnav.objectives.RankingLoss"


@store("scalarisation", "linear")
@dataclass
class LinearScalarisationConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.objectives.LinearScalarisation`."""

    scale: Any = 1.0
    tie_break: Any = 0.0
    _target_: str = "morlnav.objectives.LinearScalarisation"


@store("angle", "exact")
@dataclass
class AngleTermConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.objectives.AngleTerm`."""

    actor: float = 0.05
    critic: float = 0.0
    interpolator: Any = None
    tuneable_only: bool = False
    degrees: bool = False
    eps: float = 1e-6
    _target_: str = "morlnav.objectives.AngleTerm"


@store("angle", "clamped")
@dataclass
class ClampedAngleTermConfig(AngleTermConfig):
    """Hydra configuration for :class:`~morlnav.objectives.ClampedAngleTerm`."""

    _target_: str = "morlnav.objectives.ClampedAngleTerm"


@store("guidance", "clone")
@dataclass
class GuidanceConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.objectives.Guidance`."""

    coefficient: float = 0.3
    sharpness: float = 4.0
    margin: float = 0.1
    _target_: str = "morlnav.objectives.Guidance"


@store("search", "random")
@dataclass
class SearchConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.objectives.Search`."""

    coefficient: float = 1.0
    margin: float = -0.05
    proposals: int = 1
    _target_: str = "morlnav.objectives.Search"


@store("proposals", "critics")
@dataclass
class ProposalsConfig(PartConfig):
    """Hydra configuration for :class:`~morlnav.objectives.Proposals`."""

    search: Any = None
    guidance: Any = None
    clones: Any = None
    objectives: Any = ()
    _target_: str = "morlnav.objectives.Proposals"
