"""Data: preferences, replay, relabelling and demonstrations."""

from morlnav.data.demonstrations import (
    Disturbance,
    demonstration_settings,
    load_demonstrations,
    record_demonstrations,
    rewarded_transitions,
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
)
from morlnav.data.ranking import SnippetPairs, roll_out_ranked
from morlnav.data.simplex import preference_edges, simplex_grid

__all__ = [
    "CornerWeightedPreferences",
    "DirichletPreferences",
    "Disturbance",
    "FixedPreferences",
    "GridPreferences",
    "PreferenceSampler",
    "SegmentedPreferences",
    "SnippetPairs",
    "UniformPreferences",
    "demonstration_settings",
    "load_demonstrations",
    "preference_edges",
    "record_demonstrations",
    "rewarded_transitions",
    "roll_out_ranked",
    "save_demonstrations",
    "simplex_grid",
]
