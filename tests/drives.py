"""A drive whose truth is known, and how a file of it is read, for several tests."""

import re

import numpy as np
import pandas as pd
import pytest

from morlnav.navigation.demonstrations import import_demonstrations, read_trajectories

SCENE = {"goal_x": 6.0, "goal_y": 0.0, "human_x": 3.0, "human_y": 0.0}


def bump(rate=10.0, seconds=14.4):
    """A drive at 0.45 m/s, 1 m to the left of a human at (3, 0), to a goal at (6, 0)."""
    fine = np.linspace(-0.0, 6.4, 20001)
    side = np.exp(-(((fine - 3) / 1.2) ** 2))
    length = np.concatenate([[0], np.hypot(np.diff(fine), np.diff(side)).cumsum()])
    time = np.arange(0, seconds, 1 / rate)
    x, y = (np.interp(0.45 * time, length, value) for value in (fine, side))
    heading = np.interp(x, fine, np.arctan2(np.gradient(side), np.gradient(fine)))
    return pd.DataFrame({"time": time, "x": x, "y": y, "heading": heading}).assign(**SCENE)


TRUTH = bump()
SAID = []


def read(path, reading=None):
    """Read a file, and say what is wrong with the first bad episode."""
    file = read_trajectories(path, reading)
    if file.problems:
        raise ValueError(f"{file.path}, {next(iter(file.problems.values()))}")
    return file


def drive(path, reading=None, **settings):
    SAID.clear()
    return import_demonstrations(path, reading=reading, tell=SAID.append, **settings)


def assert_true(file, apart=1e-3, episodes=1):
    """What was read is the bump, wherever it begins."""
    assert len(file.names) == episodes
    for number in range(episodes):
        rows = file.rows(number)
        origin = file.scene["goal"][number] - [6, 0]
        for i, name in enumerate(("x", "y", "heading")):
            wanted = np.interp(file.time[rows] - file.time[rows[0]], TRUTH["time"], TRUTH[name])
            off = file.samples[rows, i] - wanted - (origin[i] if i < 2 else 0)
            assert np.abs((off + np.pi) % (2 * np.pi) - np.pi).max() < apart, name
        assert np.allclose(file.scene["human"][number] - origin, [3, 0], atol=apart)


def refused(path, *words, reading=None, how=read, **settings):
    with pytest.raises(ValueError, match=re.escape(path.name)) as caught:
        how(path, reading, **settings)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message


def write(frame, tmp_path, name="drive.csv", **how):
    frame.to_csv(tmp_path / name, **{"index": False, **how})
    return tmp_path / name
