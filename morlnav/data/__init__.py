"""Data: preferences, replay, relabelling and demonstrations."""

from morlnav.data.demonstrations import (
    Disturbance,
    demonstration_settings,
    load_demonstrations,
    record_demonstrations,
    save_demonstrations,
)
from morlnav.data.preferences import (
    CornerWeightedPreferences,
    DirichletPreferences,
    FixedPreferences,
    GridPreferences,
    PreferenceSampler,
    SegmentedPreferences,
    UniformPreferences,
    preference_edges,
    simplex_grid,
)

__all__ = [
    "CornerWeightedPreferences",
    "DirichletPreferences",
    "Disturbance",
    "FixedPreferences",
    "GridPreferences",
    "PreferenceSampler",
    "SegmentedPreferences",
    "UniformPreferences",
    "demonstration_settings",
    "load_demonstrations",
    "preference_edges",
    "record_demonstrations",
    "save_demonstrations",
    "simplex_grid",
]
