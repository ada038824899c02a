"""Trajectories in CSV and NPZ files, read and checked cell by cell."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

COLUMNS = {"pose": ("x", "y", "heading"), "action": ("v", "omega")}
SCENE_COLUMNS = {
    "start": ("start_x", "start_y", "start_heading"),
    "goal": ("goal_x", "goal_y"),
    "human": ("human_x", "human_y"),
}
BOX = ("x", "y", "half_length", "half_width", "angle")
STEP_TIME = 0.2
"""Seconds between two samples of a file that holds no times."""


@dataclass(frozen=True)
class Trajectories:
    """What a file holds: ``N`` samples of ``E`` episodes, in order.

    Attributes:
        path: of the file, to name it in messages.
        kind: ``"pose"`` or ``"action"``.
        samples: x, y (m) and heading (rad) ``[N, 3]``, or v (m/s) and ω (rad/s) ``[N, 2]``.
        time: in seconds, ``[N]``.
        episode: counted from 0, ``[N]``.
        scene: ``start`` ``[E, 3]``, ``goal`` and ``human`` ``[E, 2]``, and ``boxes`` ``[E, K, 5]``, NaN where a scene
            has fewer.
    """

    path: Path
    kind: str
    samples: np.ndarray
    time: np.ndarray
    episode: np.ndarray
    scene: Mapping[str, np.ndarray]

    def row(self, sample: int) -> str:
        """Where a sample stands in its file."""
        is_table = self.path.suffix.lower() == ".csv"
        return f"{self.path}, row {sample + 2}" if is_table else f"{self.path}, row {sample} of {self.kind}"


def read_trajectories(path: str | Path) -> Trajectories:
    """Read a CSV or NPZ file of trajectories.

    Args:
        path: ends with ``.csv`` or ``.npz``; nothing is unpickled.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming file, row and column, if it does not follow the schema.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}.")
    readers = {".csv": _read_csv, ".npz": _read_npz}
    if path.suffix.lower() not in readers:
        raise ValueError(f"{path}: trajectories are read from .csv and .npz files.")
    trajectories = readers[path.suffix.lower()](path)
    _check(trajectories)
    return trajectories


def _read_csv(path: Path) -> Trajectories:
    try:
        frame = pd.read_csv(path, skipinitialspace=True)
    except (ValueError, UnicodeDecodeError) as error:  # pandas' own errors are ValueErrors
        raise ValueError(f"{path} is no table of comma-separated values: {str(error).splitlines()[0]}") from error
    if frame.empty:
        raise ValueError(f"{path} holds no sample.")
    kind = _kind(path, lambda name: set(COLUMNS[name]) <= set(frame.columns), "columns x, y, heading or v, omega")
    columns = {
        name: _numbers(path, frame, name, blank=name not in COLUMNS[kind]) for name in _wanted(path, frame, kind)
    }
    samples = np.stack([columns[name] for name in COLUMNS[kind]], 1)
    number = columns.get("episode", np.zeros(len(frame)))
    if np.isnan(number).any():
        raise ValueError(f"{path}, row {int(np.isnan(number).argmax()) + 2}, column episode: expected a number.")
    ids, episode = _count(number)
    scene = {
        name: np.stack([_constant(path, columns[column], episode, column) for column in parts], 1)
        for name, parts in SCENE_COLUMNS.items()
        if parts[0] in columns
    }
    boxes = _boxes(frame.columns)
    scene["boxes"] = np.full((len(ids), len(boxes), len(BOX)), np.nan)
    for i, box in enumerate(boxes):
        for j, part in enumerate(BOX):
            column = f"{box}_{part}"
            scene["boxes"][:, i, j] = _constant(path, columns[column], episode, column, optional=True)
    time = columns["time"] if "time" in columns else _regular(episode)
    return Trajectories(path, kind, samples, time, episode, scene)


def _wanted(path: Path, frame: pd.DataFrame, kind: str) -> list[str]:
    """The columns that are read; others may be there."""
    scene = [name for key, parts in SCENE_COLUMNS.items() if key != "start" or kind == "action" for name in parts]
    required = [*COLUMNS[kind], *scene, *(f"{box}_{part}" for box in _boxes(frame.columns) for part in BOX)]
    missing = [name for name in required if name not in frame]
    if missing:
        raise ValueError(
            f"{path}: expected a column {missing[0]}; the columns are {', '.join(map(str, frame.columns))}."
        )
    return [*required, *(name for name in ("time", "episode") if name in frame)]


def _boxes(columns: pd.Index) -> list[str]:
    found = [re.match(r"(box\d+)_", str(name)) for name in columns]
    return list(dict.fromkeys(match[1] for match in found if match))


def _numbers(path: Path, frame: pd.DataFrame, column: str, blank: bool) -> np.ndarray:
    values = pd.to_numeric(frame[column], errors="coerce")
    wrong = (values.isna() & ~(frame[column].isna() & blank)).to_numpy()
    if wrong.any():
        row = int(wrong.argmax())
        found = "nothing" if pd.isna(frame[column][row]) else repr(str(frame[column][row]))
        raise ValueError(f"{path}, row {row + 2}, column {column}: expected a number, got {found}.")
    return values.to_numpy(float)


def _constant(path: Path, values: np.ndarray, episode: np.ndarray, column: str, optional: bool = False) -> np.ndarray:
    """One value per episode; it may be repeated or left blank in the rows after the first."""
    result = []
    for number in range(episode.max() + 1):
        rows = np.flatnonzero(episode == number)
        given = rows[~np.isnan(values[rows])]
        if not len(given) and not optional:
            raise ValueError(f"{path}, row {rows[0] + 2}, column {column}: expected a number, got nothing.")
        changed = given[values[given] != values[given[0]]] if len(given) else given
        if len(changed):
            raise ValueError(
                f"{path}, row {changed[0] + 2}, column {column}: expected {values[given[0]]:g} as before in this "
                f"episode, got {values[changed[0]]:g}."
            )
        result.append(values[given[0]] if len(given) else np.nan)
    return np.array(result)


def _read_npz(path: Path) -> Trajectories:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name], float) for name in file.files}
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is no .npz file of numbers: {error}") from error
    kind = _kind(path, arrays.__contains__, "an array pose or action")
    count = len(np.atleast_1d(arrays[kind]))
    if not count:
        raise ValueError(f"{path} holds no sample.")
    ids, episode = _count(arrays.get("episode", np.zeros(count)))
    width, scenes = len(COLUMNS[kind]), len(ids)
    shapes = {kind: (count, width), "episode": (count,), "time": (count,), "goal": (scenes, 2), "human": (scenes, 2)}
    if kind == "action":
        shapes["start"] = (scenes, 3)
    for name, shape in shapes.items():
        if name in ("episode", "time") and name not in arrays:
            continue
        if name not in arrays or arrays[name].shape != shape:
            found = list(arrays[name].shape) if name in arrays else "nothing"
            raise ValueError(f"{path}, array {name}: expected the shape {list(shape)}, got {found}.")
    boxes = arrays.get("boxes", np.zeros((scenes, 0, len(BOX))))
    if boxes.ndim != 3 or boxes.shape[0] != scenes or boxes.shape[2] != len(BOX):
        raise ValueError(f"{path}, array boxes: expected the shape [{scenes}, K, 5], got {list(boxes.shape)}.")
    scene = {name: arrays[name] for name in SCENE_COLUMNS if name in shapes} | {"boxes": boxes}
    return Trajectories(path, kind, arrays[kind], arrays.get("time", _regular(episode)), episode, scene)


def _kind(path: Path, holds, what: str) -> str:
    kinds = [name for name in COLUMNS if holds(name)]
    if len(kinds) != 1:
        raise ValueError(f"{path}: expected {what}, got {'both' if kinds else 'neither'}.")
    return kinds[0]


def _count(number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The episodes' numbers in order of appearance, and for every sample which of them it belongs to."""
    ids, first, inverse = np.unique(number, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return ids[order], np.argsort(order)[inverse]


def _regular(episode: np.ndarray) -> np.ndarray:
    """Times of samples that come at a steady rate."""
    return STEP_TIME * pd.Series(episode).groupby(episode).cumcount().to_numpy(float)


def _check(file: Trajectories) -> None:
    for name, values in {file.kind: file.samples, "time": file.time[:, None]}.items():
        wrong = ~np.isfinite(values)
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            label = "time" if name == "time" else COLUMNS[name][column]
            raise ValueError(f"{file.row(row)}, column {label}: expected a finite number, got {values[row, column]}.")
    for name in ("start", "goal", "human"):
        if name in file.scene and not np.isfinite(file.scene[name]).all():
            raise ValueError(f"{file.path}: the {name} of every episode must be finite.")
    partly = np.isnan(file.scene["boxes"]).any(-1) & ~np.isnan(file.scene["boxes"]).all(-1)
    if partly.any():
        episode, box = np.argwhere(partly)[0]
        raise ValueError(f"{file.path}, episode {episode}: box {box} needs all of {', '.join(BOX)}, or none.")
    for number in range(file.episode.max() + 1):
        rows = np.flatnonzero(file.episode == number)
        late = np.flatnonzero(np.diff(file.time[rows]) <= 0)
        if len(late):
            row = rows[late[0] + 1]
            raise ValueError(
                f"{file.row(row)}, column time: expected more than {file.time[rows[late[0]]]:g} s, the time of the row "
                f"before, got {file.time[row]:g} s."
            )
        if file.kind == "pose" and len(rows) < 2:
            raise ValueError(f"{file.row(rows[0])}: episode {number} has a single pose, expected two or more.")
