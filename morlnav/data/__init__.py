"""Data: preferences, replay, relabelling and demonstrations."""

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
    "FixedPreferences",
    "GridPreferences",
    "PreferenceSampler",
    "SegmentedPreferences",
    "UniformPreferences",
    "preference_edges",
    "simplex_grid",
]
