"""What networks see of the world, and hand-written demonstrators."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from morlnav.navigation.modules.features import NavigationFeatures

if TYPE_CHECKING:
    from morlnav.navigation.modules.afterstate import AfterstateFeatures
    from morlnav.navigation.modules.noise import WanderingNoise
    from morlnav.navigation.modules.oracle import CircumnavigationOracle, Oracle, Plan
    from morlnav.navigation.modules.passing import PassingOracle, SlowPassingOracle, WaitingOracle

_HOMES = {
    "AfterstateFeatures": "afterstate",
    "CircumnavigationOracle": "oracle",
    "Oracle": "oracle",
    "PassingOracle": "passing",
    "Plan": "oracle",
    "SlowPassingOracle": "passing",
    "WaitingOracle": "passing",
    "WanderingNoise": "noise",
}

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


def __getattr__(name: str) -> Any:
    """A robot that loads a policy needs features alone."""
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
