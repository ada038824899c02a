"""Loss modules."""

from morlnav.objectives.angle import AngleTerm, ClampedAngleTerm
from morlnav.objectives.cloning import BehaviourCloningLoss
from morlnav.objectives.guidance import Guidance
from morlnav.objectives.morl_td3 import MORLTD3Loss
from morlnav.objectives.ranking import RankingLoss
from morlnav.objectives.scalarisation import LinearScalarisation

__all__ = [
    "AngleTerm",
    "BehaviourCloningLoss",
    "ClampedAngleTerm",
    "Guidance",
    "LinearScalarisation",
    "MORLTD3Loss",
    "RankingLoss",
]
