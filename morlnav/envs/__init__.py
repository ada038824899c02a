"""Environments and their reward terms."""

from morlnav.envs.demonstration import DemonstrationObjective
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
    "Collision",
    "DemonstrationObjective",
    "Efficiency",
    "GoalProgress",
    "HumanDistance",
    "NavigationEnv",
    "Objective",
    "Sum",
    "Transition",
    "default_objectives",
]
