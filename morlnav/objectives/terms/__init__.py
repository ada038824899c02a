"""What a loss may ask for beyond the scalarised value: terms, each a class of its own."""

from morlnav.objectives.terms.angle import AngleTerm, ClampedAngleTerm
from morlnav.objectives.terms.base import Acted, Judged, LossTerm
from morlnav.objectives.terms.proposals import Guidance, Proposals, Search

__all__ = [
    "Acted",
    "AngleTerm",
    "ClampedAngleTerm",
    "Guidance",
    "Judged",
    "LossTerm",
    "Proposals",
    "Search",
]
