"""Environments and their reward terms."""

from morlnav.envs.demonstration import DemonstrationObjective
from morlnav.envs.eval_mode import eval_mode
from morlnav.envs.gym import ENV_ID, SocialNavigation, SocialNavigationVector, register
from morlnav.envs.navigation import NavigationEnv
from morlnav.envs.rewards import (
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
    "eval_mode",
]

register()
