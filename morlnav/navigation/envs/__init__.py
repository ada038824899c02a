"""Environments and their reward terms."""

from morlnav.navigation.envs.gym import SocialNavigation, SocialNavigationVector
from morlnav.navigation.envs.navigation import NavigationEnv
from morlnav.navigation.envs.rewards import (
    Collision,
    Efficiency,
    GoalProgress,
    HumanDistance,
    Objective,
    Sum,
    Transition,
    default_objectives,
)
from morlnav.navigation.registration import ENV_ID

__all__ = [
    "ENV_ID",
    "Collision",
    "Efficiency",
    "GoalProgress",
    "HumanDistance",
    "NavigationEnv",
    "Objective",
    "SocialNavigation",
    "SocialNavigationVector",
    "Sum",
    "Transition",
    "default_objectives",
]
