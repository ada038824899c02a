"""Multi-objective reinforcement learning and learning from demonstrations for TorchRL, on social robot navigation."""

from morlnav.envs import NavigationEnv
from morlnav.modules import PreferenceInterpolator
from morlnav.objectives import MORLTD3Loss
from morlnav.policy import load
from morlnav.transforms import HindsightPreferenceRelabel

__all__ = ["HindsightPreferenceRelabel", "MORLTD3Loss", "NavigationEnv", "PreferenceInterpolator", "load"]
