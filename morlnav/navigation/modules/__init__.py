"""What networks see of the world, and hand-written demonstrators."""

from morlnav.navigation.modules.afterstate import AfterstateFeatures
from morlnav.navigation.modules.features import NavigationFeatures
from morlnav.navigation.modules.noise import WanderingNoise
from morlnav.navigation.modules.oracle import CircumnavigationOracle, Oracle, Plan
from morlnav.navigation.modules.passing import PassingOracle, SlowPassingOracle, WaitingOracle

__all__ = [
    "AfterstateFeatures",
    "CircumnavigationOracle",
    "NavigationFeatures",
    "Oracle",
    "PassingOracle",
    "Plan",
    "SlowPassingOracle",
    "WaitingOracle",
    "WanderingNoise",
]
