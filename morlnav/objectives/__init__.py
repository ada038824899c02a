"""Loss modules."""

from morlnav.modules.scalarisation import LinearScalarisation
from morlnav.objectives.cloning import BehaviourCloningLoss
from morlnav.objectives.morl_td3 import MORLTD3Loss
from morlnav.objectives.ranking import RankingLoss
from morlnav.objectives.terms import (
    Acted,
    AngleTerm,
    ClampedAngleTerm,
    Guidance,
    Judged,
    LossTerm,
    Proposals,
    Search,
)

__all__ = [
    "Acted",
    "AngleTerm",
    "BehaviourCloningLoss",
    "ClampedAngleTerm",
    "Guidance",
    "Judged",
    "LinearScalarisation",
    "LossTerm",
    "MORLTD3Loss",
    "Proposals",
    "RankingLoss",
    "Search",
]
