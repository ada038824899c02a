"""Modules: networks, the preference interpolator and the reward model."""

from morlnav.modules.interpolator import PreferenceInterpolator
from morlnav.modules.networks import Actor, NavigationFeatures, VectorCritic

__all__ = ["Actor", "NavigationFeatures", "PreferenceInterpolator", "VectorCritic"]
