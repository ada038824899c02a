"""Environments and their reward terms."""

from morlnav.navigation.envs.demonstration import DemonstrationObjective
from morlnav.navigation.envs.gym import ENV_ID, SocialNavigation, SocialNavigationVector, register
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

__all__ = [
    "ENV_ID",
    "Collision",
    "DemonstrationObjective",
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

register()
