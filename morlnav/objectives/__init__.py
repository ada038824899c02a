"""Loss modules."""

from morlnav.objectives.angle import AngleTerm, ClampedAngleTerm
from morlnav.objectives.morl_td3 import MORLTD3Loss
from morlnav.objectives.scalarisation import LinearScalarisation

__all__ = ["AngleTerm", "ClampedAngleTerm", "LinearScalarisation", "MORLTD3Loss"]
