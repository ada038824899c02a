"""Data: preferences, replay, ranked and compared roll-outs."""

from morlnav.data.comparisons import ComparedPairs, Comparison, Snippet, read_comparisons
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
    "ComparedPairs",
    "Comparison",
    "CornerWeightedPreferences",
    "DirichletPreferences",
    "FixedPreferences",
    "GridPreferences",
    "PreferenceSampler",
    "ReplayBuffer",
    "SegmentedPreferences",
    "Snippet",
    "SnippetPairs",
    "UniformPreferences",
    "preference_edges",
    "read_comparisons",
    "roll_out_ranked",
    "simplex_grid",
]
