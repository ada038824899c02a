"""Data: preferences, replay and ranked roll-outs."""

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
from morlnav.data.replay import ReplayBuffer
from morlnav.simplex import preference_edges, simplex_grid

__all__ = [
    "CornerWeightedPreferences",
    "DirichletPreferences",
    "FixedPreferences",
    "GridPreferences",
    "PreferenceSampler",
    "ReplayBuffer",
    "SegmentedPreferences",
    "SnippetPairs",
    "UniformPreferences",
    "preference_edges",
    "roll_out_ranked",
    "simplex_grid",
]
