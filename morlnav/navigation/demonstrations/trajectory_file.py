"""Trajectories in files: what a table of any dialect says about drives and their scenes, and whether it can be true."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.arrays import BOX
from morlnav.navigation.demonstrations.columns import TOPICS, Columns, Reading
from morlnav.navigation.demonstrations.plausible import check_heading, check_times, check_units, courses
from morlnav.navigation.demonstrations.plausible_scene import check_angles, check_distances, check_sizes
from morlnav.navigation.demonstrations.rows import one_track, with_poses
from morlnav.navigation.demonstrations.samples import headings, times, tremble
from morlnav.navigation.demonstrations.table import Table
from morlnav.navigation.demonstrations.tables import read_table

COLUMNS = {"pose": ("x", "y", "heading"), "action": ("v", "omega")}
SCENE_COLUMNS = {
    "start": ("start_x", "start_y", "start_heading"),
    "goal": ("goal_x", "goal_y"),
    "human": ("human_x", "human_y"),
}
SPREAD = {"human": 0.25}
"""How far a measured thing may lie from its median, in metres; 0.05 where nothing else is said."""
FAR = 200.0
"""Metres within which a scene lies; a scene further from the origin is counted from where its drive begins."""


@dataclass(frozen=True)
class Trajectories:
    """What a file holds: ``N`` samples of ``E`` episodes, in order.

    Attributes:
        table: that it was read from, to name rows in messages.
        kind: ``"pose"`` or ``"action"``.
        samples: x, y (m) and heading (rad) ``[N, 3]``, or v (m/s) and ω (rad/s) ``[N, 2]``.
        time: in seconds, ``[N]``.
        episode: counted from 0, ``[N]``.
        scene: ``start`` ``[E, 3]``, ``goal`` and ``human`` ``[E, 2]``, and ``boxes`` ``[E, K, 5]``, NaN where a scene
            has fewer.
        names: of the episodes.
        problems: what is wrong with an episode, by its number; all others can be driven.
        used: the file's columns that were read.
        ignored: the others.
        notes: what was assumed or left out, a few words each.
    """

    table: Table
    kind: str
    samples: np.ndarray
    time: np.ndarray
    episode: np.ndarray
    scene: Mapping[str, np.ndarray]
    names: list[str]
    problems: dict[int, str] = field(default_factory=dict)
    used: list[str] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def path(self) -> Path:
        """The file."""
        return self.table.path

    def rows(self, number: int) -> np.ndarray:
        """The samples of an episode."""
        return np.flatnonzero(self.episode == number)

    @contextmanager
    def concerning(self, number: int) -> Iterator[None]:
        """Note a ``ValueError`` as what is wrong with an episode, and go on."""
        try:
            yield
        except ValueError as error:
            self.problems.setdefault(number, str(error))


def read_trajectories(path: str | Path, reading: Reading | None = None, max_speed: float = 0.5) -> Trajectories:
    """Read a file of trajectories: text (CSV, TSV and their kin), arrays (NPZ), or a ROS bag.

    Args:
        path: of the file; nothing is unpickled.
        reading: what is known beforehand about columns, units and all else.
        max_speed: of the robot that shall drive them, in m/s, which tells whether units can be right.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming file, row and column, if it does not follow the schema or cannot be meant so.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "drive.csv"
        >>> rows = ["stamp;x [mm];y [mm];yaw", *(f"{0.1 * i};{40 * i};0;0" for i in range(60))]
        >>> _ = file.write_text(chr(10).join(rows))
        >>> drive = read_trajectories(file, Reading(goal="end", human=(1.0, 1.0)))
        >>> drive.samples[-1].tolist(), drive.scene["goal"].tolist()
        ([2.36, 0.0, 0.0], [[2.36, 0.0]])
    """
    path, reading = Path(path), reading or Reading()
    if path.suffix.lower() in (".bag", ".mcap", ".db3") or (path / "metadata.yaml").is_file():
        from morlnav.navigation.demonstrations.bags import read_bag  # only who has bags needs their package

        table, reading = read_bag(path, reading)
    else:
        table = read_table(path, reading.separator, reading.decimal, reading.names)
        if topics := [name for name in reading.columns if name in TOPICS]:
            raise ValueError(f"{path} is no bag, in which {topics[0]} would be a topic; {table}.")
    return _Reader(with_poses(one_track(table, reading), reading), reading).trajectories(max_speed)


class _Reader:
    """Reads trajectories from a table."""

    def __init__(self, table: Table, reading: Reading) -> None:
        self.table, self.reading, self.columns = table, reading, Columns(table, reading)
        self.notes, self.problems = list(table.notes), {}
        columns = self.columns
        if all(part in columns for part in ("x", "y")):
            self.kind = "pose"
        elif all(part in columns for part in COLUMNS["action"]):
            self.kind = "action"
        else:
            globe = any(re.match("lat|lon|lng", name.lower()) for name in table.columns)
            advice = "; degrees of latitude and longitude have to become metres first, as of UTM" if globe else ""
            raise ValueError(
                f"{table.path}: expected columns x, y, heading or v, omega, got neither; {table}; say which is which "
                f"with --columns x=NAME y=NAME{advice}."
            )
        if reading.human == "scan":
            raise ValueError(f"{table.path} is no bag, whose scans could show the human; give --human X Y.")
        if self.kind == "action" and (reading.heading or reading.goal == "end" or reading.max_gap is not None):
            raise ValueError(
                f"{table.path} holds actions, for which headings, ends and gaps are not told; leave them out."
            )
        ids = columns.ids()
        self.episode, names = pd.factorize(ids) if ids is not None else (np.zeros(len(table.row), int), ["0"])
        self.names = [str(name) for name in names]

    def trajectories(self, max_speed: float) -> Trajectories:
        """All of it; ``max_speed`` tells whether units can be right."""
        table, columns, reading, names = self.table, self.columns, self.reading, self.names
        time = times(columns, self.episode, self.notes)
        values = [columns[part] for part in (COLUMNS["action"] if self.kind == "action" else ("x", "y"))]
        heading = headings(columns, self.notes) if self.kind == "pose" else None
        samples = np.stack(values if heading is None else [*values, heading], 1)
        repeats = (np.diff(np.column_stack([time, self.episode, samples]), axis=0) == 0).all(1)
        if repeats.any():
            self.notes.append(f"{repeats.sum()} repeated rows left out")
        keep, scene = np.append(True, ~repeats), self.scene()
        table = replace(table, row=table.row[keep])
        file = Trajectories(table, self.kind, samples[keep], time[keep], self.episode[keep], scene, names,
                            self.problems, notes=self.notes)  # fmt: skip
        for number in range(len(names)):
            with file.concerning(number):
                check_times(file, number, reading)
        check_units(file, columns, max_speed, reading.max_gap)
        if self.kind == "pose":
            if heading is None:
                file = replace(file, samples=np.column_stack([file.samples, _from_motion(file)]))
            check_heading(file, columns)
            if reading.goal == "end":
                scene["goal"] = np.stack([file.samples[file.rows(number)[-1], :2] for number in range(len(names))])
        check_angles(file, columns)
        check_sizes(file, columns)
        check_distances(file, columns)
        file = _near_the_origin(file)
        for name in ("goal", "human"):
            if getattr(reading, name) is not None and any(f"{name}_{part}" in columns for part in "xy"):
                file.notes.append(f"the {name} is as given, not as in its columns")
        columns.check_all_is_used()
        return replace(file, used=columns.used, ignored=columns.ignored)

    def scene(self) -> dict[str, np.ndarray]:
        """Arrays of the scene, a row per episode."""
        count, scene = len(self.names), {}
        for name, parts in SCENE_COLUMNS.items():
            given = getattr(self.reading, name, None)
            if name == "start" and self.kind == "pose":
                continue
            if given is not None:  # the end of a drive is not known yet
                scene[name] = np.tile((0.0, 0.0) if isinstance(given, str) else np.asarray(given, float), (count, 1))
                continue
            scene[name] = np.stack([self.constant(part) for part in parts], 1)
            measured = np.stack([self.columns[part] for part in parts], 1)
            spread = np.nanmax(np.abs(measured - scene[name][self.episode]), initial=0)
            if spread > 0.001:
                self.notes.append(f"the {name} lies where it is measured within {spread:.2g} (median)")
        boxes = dict.fromkeys(match[0] for name in self.columns.name if (match := re.match(r"box\d+", name)))
        scene["boxes"] = np.full((count, len(boxes), len(BOX)), np.nan)
        for i, box in enumerate(boxes):
            for j, part in enumerate(BOX):
                name, whole = f"{box}_{part}", f"{box}_{part}".replace("half_", "")
                halved = name not in self.columns and whole in self.columns
                scene["boxes"][:, i, j] = self.constant(whole if halved else name) / (2 if halved else 1)
            there = ~np.isnan(scene["boxes"][:, i])
            for number in np.flatnonzero(there.any(1) & ~there.all(1)):
                self.note(number, f"episode {self.names[number]}: {box} needs all of {', '.join(BOX)}, or none")
        return scene

    def note(self, number: int, problem: str) -> None:
        """Keep the first thing that is wrong with an episode."""
        self.problems.setdefault(int(number), problem)

    def constant(self, name: str) -> np.ndarray:
        """One value per episode ``[E]``: the median of those that are there, which lie close together."""
        columns, table, subject = self.columns, self.table, name.partition("_")[0]
        advice = {"goal": "--goal X Y or --goal end", "human": "--human X Y"}.get(subject)
        if name not in columns:
            raise ValueError(
                f"{table.path}: expected a column {name}; {table}; say which it is with --columns {name}=NAME"
                f"{f' or {advice}' if advice else ''}."
            )
        values, where = columns[name], f"column {columns.name[name]}"
        groups = pd.Series(values).groupby(self.episode)
        allowed, middle = SPREAD.get(subject, 0.05), groups.median().to_numpy()
        for number, cells in groups:
            here = cells.dropna()
            if here.empty and not subject.startswith("box"):
                missing = f"expected a number, got nothing{f'; give it by {advice}' if advice else ''}"
                self.note(number, f"{table.at(cells.index[0])}, {where}: {missing}")
            if here.empty:
                continue
            third = max(1, len(here) // 3)
            drift = abs(here[-third:].median() - here[:third].median())
            far = (here - here.iloc[0]).abs() > allowed
            far = far if far.any() else (here - middle[number]).abs() > allowed
            if subject == "human" and drift > (0.1 if len(here) > 8 else allowed):
                self.note(
                    number,
                    f"{table.at(here.index[-1])}, {where}: the human walks by {np.ptp(here):.2g} m, and the world's "
                    f"stands; expected one place per episode",
                )
            elif ((here - middle[number]).abs() > allowed).any():
                guess = "; is it told from the robot, or does another drive begin here?" if subject == "goal" else ""
                row = far.idxmax()
                expected = f"expected {here.iloc[0]:g} as before in this episode, got {here[row]:g}{guess}"
                self.note(number, f"{table.at(row)}, {where}: {expected}")
        return middle


def _from_motion(file: Trajectories) -> np.ndarray:
    """Headings ``[N]`` in the direction of the motion, which standing still does not change."""
    heading = np.zeros(len(file.time))
    begin, end, course = courses(file, np.clip(8 * _jitter(file), 0.1, 0.3))
    middle = (file.time[begin] + file.time[end]) / 2
    for number in range(len(file.names)):
        rows, mine = file.rows(number), file.episode[begin] == number
        with file.concerning(number):
            if not mine.any():
                raise ValueError(
                    f"{file.table.at(rows[0])}: episode {file.names[number]} does not move, so nothing tells its "
                    f"heading"
                )
            heading[rows] = _extended(file.time[rows], middle[mine], np.unwrap(course[mine]))
    return heading


def _jitter(file: Trajectories) -> float:
    """By how much places tremble in metres, as if they were sampled evenly; 0 for a few of them."""
    each = [file.samples[file.rows(number), :2] for number in range(len(file.names))]
    return max((tremble(places).max() for places in each if len(places) >= 8), default=0.0)


def _extended(at: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values between those at given times, and beyond them along the line of the last two."""
    result = np.interp(at, time, values)
    for beyond, i, j in ((at < time[0], 0, 1), (at > time[-1], -1, -2)):
        if len(time) > 1 and beyond.any():
            slope = np.clip((values[j] - values[i]) / (time[j] - time[i]), -1.0, 1.0)
            reach = np.clip(at[beyond] - time[i], -0.5, 0.5)
            result[beyond] = values[i] + slope * reach
    return result


def _near_the_origin(file: Trajectories) -> Trajectories:
    """Scenes far from the origin counted from where their drive begins, while numbers are in double precision."""
    starts = np.array([file.rows(number)[0] for number in range(len(file.names))])
    begin = file.samples[starts, :2] if file.kind == "pose" else file.scene["start"][:, :2]
    origin = np.where((np.abs(begin) > FAR).any(1, keepdims=True), begin.round(), 0.0)
    if not origin.any():
        return file
    scene, samples = {name: value.copy() for name, value in file.scene.items()}, file.samples.copy()
    for value in scene.values():
        value[..., :2] -= origin if value.ndim == 2 else origin[:, None]
    if file.kind == "pose":
        samples[:, :2] -= origin[file.episode]
    note = f"the origin is laid to ({origin[0, 0]:g}, {origin[0, 1]:g}) m"
    return replace(file, scene=scene, samples=samples, notes=[*file.notes, note])
