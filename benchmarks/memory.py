"""Bytes that a transition takes in the replay buffer."""

from __future__ import annotations

import sys

import numpy as np

from benchmarks.learner import random_rows
from benchmarks.recipes import filled_trainer, recipe
from benchmarks.timing import Effort, Row

TITLE = "Memory: bytes per transition in the replay buffer"
NOTES = """4 objectives, 3 of them tuneable, 34 observed numbers. morlnav: the storage of the trainer that
`morlnav-train` runs, over its capacity. The fewest: every number of a transition once in 4 bytes, and one byte for
its end. CAPQL keeps arrays in a tuple; PD-MORL (estimated alike) keeps each transition four times."""


def measure(effort: Effort) -> list[Row]:
    """Weigh the storages."""
    cfg = recipe(effort, "replay.storage.max_size=10000")
    trainer, _ = filled_trainer(cfg, 1)
    storage = trainer.replay_buffer.storage
    observation, action, reward, preference, flag = 34, 2, 4, 3, 1
    arrays = [column[:1].numpy()[0] for column in random_rows(1).values()]
    entry = _weigh([*arrays, np.zeros(reward, np.float32)])  # a weight vector with an entry for every objective
    sizes = {
        "morlnav": storage._storage.bytes() / storage.max_size,
        "fewest": 4 * (observation + action + reward + preference) + flag,
        "morl-baselines CAPQL": entry,
        "PD-MORL": 4 * entry,
    }
    return [
        Row("memory", "per transition", name, "bytes", [float(size)], less_is_better=True, ours=name == "morlnav")
        for name, size in sizes.items()
    ]


def _weigh(arrays: list[np.ndarray]) -> int:
    copies = [np.array(array).copy() for array in arrays]  # as CAPQL makes them
    return sum(map(sys.getsizeof, copies)) + sys.getsizeof(tuple(copies)) + 8  # and the list's pointer
