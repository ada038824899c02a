"""Demonstrations: recorded from a policy, driven by hand, or imported."""

from morlnav.navigation.demonstrations.columns import Reading
from morlnav.navigation.demonstrations.export import export_demonstrations
from morlnav.navigation.demonstrations.folder import (
    demonstration_settings,
    demonstrations_digest,
    join_demonstrations,
    load_demonstrations,
    save_demonstrations,
)
from morlnav.navigation.demonstrations.minari import from_minari, to_minari
from morlnav.navigation.demonstrations.record import Disturbance, record_demonstrations, rewarded_transitions
from morlnav.navigation.demonstrations.replay import recorded_demonstrations, replay_demonstrations
from morlnav.navigation.demonstrations.seed_replay import SeedReplay
from morlnav.navigation.demonstrations.sources import RecordedFolder, RecordedPolicy
from morlnav.navigation.demonstrations.trajectories import import_demonstrations
from morlnav.navigation.demonstrations.trajectory_file import Trajectories, read_trajectories

__all__ = [
    "Disturbance",
    "Reading",
    "RecordedFolder",
    "RecordedPolicy",
    "SeedReplay",
    "Trajectories",
    "demonstration_settings",
    "demonstrations_digest",
    "export_demonstrations",
    "from_minari",
    "import_demonstrations",
    "join_demonstrations",
    "load_demonstrations",
    "read_trajectories",
    "record_demonstrations",
    "recorded_demonstrations",
    "replay_demonstrations",
    "rewarded_transitions",
    "save_demonstrations",
    "to_minari",
]
