"""Multi-objective reinforcement learning and learning from demonstrations for TorchRL, proven on social navigation."""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from morlnav.deployment import load
    from morlnav.modules import PreferenceInterpolator
    from morlnav.navigation.envs import NavigationEnv
    from morlnav.objectives import MORLTD3Loss
    from morlnav.transforms import HindsightPreferenceRelabel

_HOMES = {
    "HindsightPreferenceRelabel": "morlnav.transforms",
    "MORLTD3Loss": "morlnav.objectives",
    "NavigationEnv": "morlnav.navigation.envs",
    "PreferenceInterpolator": "morlnav.modules",
    "load": "morlnav.deployment",
}

__all__ = ["HindsightPreferenceRelabel", "MORLTD3Loss", "NavigationEnv", "PreferenceInterpolator", "load"]


def __getattr__(name: str) -> Any:
    """Each name brings what it stands on, and no more: a robot that loads a policy waits for no TorchRL."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


if "gymnasium" in sys.modules:  # whoever has no use for it does not wait for it
    import_module("morlnav.navigation.registration")
