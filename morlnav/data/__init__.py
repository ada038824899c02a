"""Data: preferences, replay, relabelling and demonstrations."""

from morlnav.data.demonstrations import (
    demonstration_settings,
    demonstrations_digest,
    load_demonstrations,
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
from morlnav.data.recorded import recorded_demonstrations, replay_demonstrations
from morlnav.data.recording import Disturbance, record_demonstrations, rewarded_transitions
from morlnav.data.simplex import preference_edges, simplex_grid
from morlnav.data.trajectories import export_demonstrations, import_demonstrations
from morlnav.data.trajectory_file import Trajectories, read_trajectories

__all__ = [
    "CornerWeightedPreferences",
    "DirichletPreferences",
    "Disturbance",
    "FixedPreferences",
    "GridPreferences",
    "PreferenceSampler",
    "SegmentedPreferences",
    "SnippetPairs",
    "Trajectories",
    "UniformPreferences",
    "demonstration_settings",
    "demonstrations_digest",
    "export_demonstrations",
    "import_demonstrations",
    "load_demonstrations",
    "preference_edges",
    "read_trajectories",
    "record_demonstrations",
    "recorded_demonstrations",
    "replay_demonstrations",
    "rewarded_transitions",
    "roll_out_ranked",
    "save_demonstrations",
    "simplex_grid",
]
