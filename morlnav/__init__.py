"""Multi-objective reinforcement learning and learning from demonstrations for TorchRL, on social robot navigation."""

from typing import TYPE_CHECKING, Any

from morlnav.envs import NavigationEnv
from morlnav.modules import PreferenceInterpolator
from morlnav.objectives import MORLTD3Loss
from morlnav.transforms import HindsightPreferenceRelabel

if TYPE_CHECKING:
    from morlnav.policy import load

__all__ = ["HindsightPreferenceRelabel", "MORLTD3Loss", "NavigationEnv", "PreferenceInterpolator", "load"]


def __getattr__(name: str) -> Any:
    """``load`` needs the whole package and what it draws with; workers and users of single parts do not."""
    if name == "load":
        from morlnav.policy import load

        return load
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
