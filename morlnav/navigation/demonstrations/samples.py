"""When and in which heading each row of a table was sampled."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.columns import Columns
from morlnav.navigation.demonstrations.names import plain
from morlnav.navigation.demonstrations.table import Table

STEP_TIME = 0.2
"""Seconds between two samples of a file that holds no times."""
RATES = re.compile(
    r"(d_?t|delta_?t|(time_?)?step(_?time)?|time_?step|period|interval)|(sampl\w*_?)?(rate|freq\w*)|fps|hz"
)
"""Names of what may tell the time between samples, or else how many there are in a second."""
WXYZ = [1, 2, 3, 0]
"""Places of x, y, z and w where w stands first."""
LEAN = 0.15
"""Half of how much a robot on wheels leans at most, in rad."""


def times(columns: Columns, episode: np.ndarray, notes: list[str]) -> np.ndarray:
    """When each row was sampled, in seconds ``[N]``.

    Args:
        columns: of the table.
        episode: of each row, ``[N]``.
        notes: receives what is assumed.

    Raises:
        ValueError: if it is told twice, or it is not clear by what.
    """
    table, rate = columns.table, columns.reading.rate
    stamp = next((name for name in ("time", "stamp_sec") if name in columns), None)
    if stamp is not None:
        if rate is not None:
            raise ValueError(f"{table.path} tells times in column {columns.name[stamp]}; a rate is for files without.")
        if "nanosec" not in columns:
            return columns[stamp]
        return columns["stamp_sec" if "stamp_sec" in columns else "time"] + 1e-9 * columns["nanosec"]
    if "frame" in columns:
        if rate is None:
            raise ValueError(
                f"{table.path} tells no times but numbers in column {columns.name['frame']}; how many are there in "
                f"a second? Then: --rate NUMBER."
            )
        return columns["frame"] / rate
    count = pd.Series(episode).groupby(episode).cumcount().to_numpy(float)
    if rate is not None:
        return count / rate
    for name in table.columns:
        if name not in columns.name.values() and name not in columns.episodes:
            _ask_for_time(table, name, episode)
    notes.append(f"no times, so rows are {STEP_TIME:g} s apart")
    return count * STEP_TIME


def _ask_for_time(table: Table, name: str, episode: np.ndarray) -> None:
    """Refuse a column that nobody named and that could tell the time: it grows, or says how far rows are apart."""
    try:
        values = table.numbers(name).astype(float)
    except ValueError:
        return
    rows, step = f"--rate {1 / STEP_TIME:g} or another number of rows in a second", float(np.median(values))
    if (match := RATES.fullmatch(plain(name))) and step > 0:
        rate = 1 / step if match[1] else step
        raise ValueError(
            f"{table.path} tells no times; does {name} say how far rows are apart? Then: --rate {rate:g}; if "
            f"not, give {rows}."
        )
    steps = np.diff(values)[np.diff(episode) == 0]
    is_number = (steps == 1).all() and values[0] in (0, 1)
    if len(steps) and (steps > 0).all() and not is_number:
        raise ValueError(
            f"{table.path}: which column tells the time, is it {name}? Then: --columns time={name}; if none "
            f"does, give {rows}; {table}."
        )


def tremble(values: np.ndarray) -> np.ndarray:
    """By how much each column of evenly sampled values ``[N, K]`` jitters: the noise's standard deviation ``[K]``.

    It shows in third differences, where a drive that bends does not.

    Examples:
        >>> time = np.linspace(0, 9, 1000)
        >>> noise = np.random.default_rng(0).normal(0, 0.1, 1000)
        >>> tremble(np.stack([np.sin(time), np.sin(time) + noise], 1)).round(1).tolist()
        [0.0, 0.1]
    """
    return np.median(np.abs(np.diff(values, 3, axis=0)), axis=0) / (0.6745 * 20**0.5)


def headings(columns: Columns, notes: list[str]) -> np.ndarray | None:
    """Where the robot looks, in rad ``[N]``; ``None`` if it comes from the motion.

    Args:
        columns: of the table.
        notes: receives where it comes from.

    Raises:
        ValueError: for quaternions of a robot that would lean, or of another length than 1.
    """
    how = columns.reading.heading
    quaternion = next((parts for parts in (("qx", "qy", "qz", "qw"), ("qz", "qw"), ("q0", "q1", "q2", "q3"))
                       if all(part in columns for part in parts)), None)  # fmt: skip
    if how == "motion" or not ("heading" in columns or quaternion):
        why = "as asked" if how == "motion" else "for no column tells them"
        notes.append(f"headings are those of the motion, {why}")
        return None
    if "heading" in columns:
        heading = columns["heading"]
    else:
        heading = _yaw(columns, quaternion)
        notes.append("headings come from quaternions")
    if how is not None:
        notes.append(f"headings are {how}, as said")
    return {"clockwise": -heading, "compass": np.pi / 2 - heading}.get(how, heading)


def _yaw(columns: Columns, parts: tuple[str, ...]) -> np.ndarray:
    """Headings ``[N]`` of quaternions in columns."""
    table, quaternion = columns.table, np.stack([columns[part] for part in parts], 1)
    where = f"columns {', '.join(parts)}"
    quaternion = np.pad(quaternion, ((0, 0), (4 - len(parts), 0)))
    if parts[0] == "q0" and _lean(quaternion[:, WXYZ]) < _lean(quaternion):
        quaternion = quaternion[:, WXYZ]
    return yaw_of(quaternion, lambda row: f"{table.path}, {f'{table.at(row)}, ' if row is not None else ''}{where}")


def yaw_of(quaternion: np.ndarray, place: Callable[[int | None], str]) -> np.ndarray:
    """Headings ``[N]`` of the orientations of a robot that stands upright.

    Args:
        quaternion: x, y, z, w, ``[N, 4]``.
        place: of a sample, or of all for ``None``, for messages.

    Raises:
        ValueError: for quaternions of a robot that would lean, or of another length than 1.

    Examples:
        >>> yaw_of(np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]]), str).round(2).tolist()
        [0.0, 3.14]
    """
    size = np.linalg.norm(quaternion, axis=1)
    wrong = ~(np.abs(size - 1) < 0.05)
    if wrong.any():
        row = int(wrong.argmax())
        raise ValueError(f"{place(row)}: expected a quaternion of length 1, got length {size[row]:.3g}.")
    quaternion = quaternion / size[:, None]
    orders = {"x, y, z, w": [3, 0, 1, 2], "w, x, y, z": WXYZ}
    here, lean = _lean(quaternion), {order: _lean(quaternion[:, places]) for order, places in orders.items()}
    likely = min(lean, key=lean.get)
    if here > LEAN or (here > 0.05 and lean[likely] < here / 5):
        guess = "is it of another body, or is another axis up?"
        guess = f"are its cells in the order {likely}?" if lean[likely] < here / 2 else guess
        raise ValueError(f"{place(None)}: the robot would lean by {2 * here:.2f} rad; {guess}")
    x, y, z, w = quaternion.T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _lean(quaternion: np.ndarray) -> float:
    """By half of how much a body of these orientations ``[N, 4]`` (x, y, z, w) leans in rad, at a sine's worth."""
    return float(np.quantile(np.hypot(quaternion[:, 0], quaternion[:, 1]), 0.9))
