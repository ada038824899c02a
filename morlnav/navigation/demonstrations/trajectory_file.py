"""Trajectories in files: what a table of any dialect says about drives and their scenes, and whether it can be true."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.columns import TOPICS, Columns, Reading, one_track, with_poses
from morlnav.navigation.demonstrations.plausible import (
    check_angles,
    check_distances,
    check_heading,
    check_times,
    check_units,
    courses,
)
from morlnav.navigation.demonstrations.table import Table, read_table

COLUMNS = {"pose": ("x", "y", "heading"), "action": ("v", "omega")}
SCENE_COLUMNS = {
    "start": ("start_x", "start_y", "start_heading"),
    "goal": ("goal_x", "goal_y"),
    "human": ("human_x", "human_y"),
}
BOX = ("x", "y", "half_length", "half_width", "angle")
STEP_TIME = 0.2
"""Seconds between two samples of a file that holds no times."""
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
    table = with_poses(one_track(table, reading), reading)
    return _assemble(table, Columns(table, reading), reading, max_speed)


def _assemble(table: Table, columns: Columns, reading: Reading, max_speed: float) -> Trajectories:
    notes = list(table.notes)
    kind = _kind(table, columns)
    if reading.human == "scan":
        raise ValueError(f"{table.path} is no bag, whose scans could show the human; give --human X Y.")
    if kind == "action" and (reading.heading or reading.goal == "end" or reading.max_gap is not None):
        raise ValueError(f"{table.path} holds actions, for which headings, ends and gaps are not told; leave them out.")
    ids = columns.ids()
    episode, names = pd.factorize(ids) if ids is not None else (np.zeros(len(table.row), int), ["0"])
    names = [str(name) for name in names]
    time = _time(table, columns, reading, episode, notes)
    samples = np.stack([columns[part] for part in (COLUMNS["action"] if kind == "action" else ("x", "y"))], 1)
    heading = _heading(table, columns, reading, notes) if kind == "pose" else None
    _finite(table, columns, time, samples, heading)
    keep = _without_repetitions(time, episode, samples, heading)
    if not keep.all():
        notes.append(f"{(~keep).sum()} repeated rows left out")
    scene, moved = _scene(table, columns, reading, kind, episode, names, notes)
    table = replace(table, row=table.row[keep])
    time, episode, samples = time[keep], episode[keep], samples[keep]
    file = Trajectories(table, kind, samples, time, episode, scene, names, dict(moved), notes=notes)
    for number in range(len(names)):
        with file.concerning(number):
            check_times(file, number, reading)
    if kind == "pose":
        check_units(file, columns, max_speed)
        heading = _from_motion(file) if heading is None else heading[keep]
        check_heading(file, columns, heading)
        file = replace(file, samples=np.concatenate([samples, heading[:, None]], 1))
        if reading.goal == "end":
            ends = [file.rows(number)[-1] for number in range(len(names))]
            scene["goal"] = file.samples[ends, :2]
    check_angles(file, columns)
    check_distances(file, columns)
    file = _near_the_origin(file)
    for name in ("goal", "human"):
        if getattr(reading, name) is not None and any(f"{name}_{part}" in columns for part in "xy"):
            file.notes.append(f"the {name} is as given, not as in its columns")
    columns.check_all_is_used()
    file.used.extend(columns.used)
    file.ignored.extend(columns.ignored)
    return file


def _kind(table: Table, columns: Columns) -> str:
    if all(part in columns for part in ("x", "y")):
        return "pose"
    if all(part in columns for part in COLUMNS["action"]):
        return "action"
    raise ValueError(
        f"{table.path}: expected columns x, y, heading or v, omega, got neither; {table}; say which is which with "
        f"--columns x=NAME y=NAME."
    )


def _time(table: Table, columns: Columns, reading: Reading, episode: np.ndarray, notes: list[str]) -> np.ndarray:
    if "time" in columns or "stamp_sec" in columns:
        if reading.rate is not None:
            raise ValueError(
                f"{table.path} tells times in column {columns.name.get('time') or columns.name['stamp_sec']}; a rate "
                f"is for files without."
            )
        if "nanosec" not in columns:
            return columns["time" if "time" in columns else "stamp_sec"]
        return columns["stamp_sec" if "stamp_sec" in columns else "time"] + 1e-9 * columns["nanosec"]
    if "frame" in columns:
        if reading.rate is None:
            raise ValueError(
                f"{table.path} tells no times but numbers in column {columns.name['frame']}; how many are there in a "
                f"second? Then: --rate NUMBER."
            )
        return columns["frame"] / reading.rate
    count = pd.Series(episode).groupby(episode).cumcount().to_numpy(float)
    if reading.rate is not None:
        return count / reading.rate
    for name in table.columns:
        if name not in columns.name.values() and name not in columns.episodes and _grows(table, name, episode):
            raise ValueError(
                f"{table.path}: which column tells the time, is it {name}? Then: --columns time={name}; if none does, "
                f"give --rate {1 / STEP_TIME:g} or another number of rows in a second; {table}."
            )
    notes.append(f"no times, so rows are {STEP_TIME:g} s apart")
    return count * STEP_TIME


def _grows(table: Table, name: str, episode: np.ndarray) -> bool:
    """Whether a column could be a time: it grows within every episode, and is not the number of the row."""
    try:
        values = table.numbers(name).astype(float)
    except ValueError:
        return False
    same = np.diff(episode) == 0
    steps = np.diff(values)[same]
    return len(steps) > 0 and bool((steps > 0).all()) and not bool((steps == 1).all() and values[0] in (0, 1))


def _heading(table: Table, columns: Columns, reading: Reading, notes: list[str]) -> np.ndarray | None:
    """Headings ``[N]``; ``None`` if they come from the motion."""
    quaternion = next((parts for parts in (("qx", "qy", "qz", "qw"), ("qz", "qw"), ("q0", "q1", "q2", "q3"))
                       if all(part in columns for part in parts)), None)  # fmt: skip
    if reading.heading == "motion":
        notes.append("headings are those of the motion, as asked")
        return None
    if "heading" in columns:
        heading = columns["heading"]
    elif quaternion is not None:
        heading = _yaw(table, np.stack([columns[part] for part in quaternion], 1), quaternion)
        notes.append("headings come from quaternions")
    else:
        notes.append("headings are those of the motion, for no column tells them")
        return None
    if reading.heading is not None:
        notes.append(f"headings are {reading.heading}, as said")
    return {"clockwise": -heading, "compass": np.pi / 2 - heading}.get(reading.heading, heading)


def _yaw(table: Table, quaternion: np.ndarray, parts: tuple[str, ...]) -> np.ndarray:
    """Headings ``[N]`` of quaternions ``[N, 2|4]`` of a robot that stands upright."""
    if quaternion.shape[1] == 2:
        quaternion = np.concatenate([np.zeros_like(quaternion), quaternion], 1)
    size = np.linalg.norm(quaternion, axis=1)
    wrong = ~(np.abs(size - 1) < 0.05)
    if wrong.any():
        row = int(wrong.argmax())
        raise ValueError(
            f"{table.path}, {table.at(row)}, columns {', '.join(parts)}: expected a quaternion of length 1, got length "
            f"{size[row]:.3g}."
        )
    orders = {"x, y, z, w": [3, 0, 1, 2], "w, x, y, z": [1, 2, 3, 0]}
    lean = {order: _lean(quaternion[:, places]) for order, places in orders.items()}
    likely, here = min(lean, key=lean.get), _lean(quaternion)
    if parts[0] == "q0":
        quaternion = quaternion if here <= lean["w, x, y, z"] else quaternion[:, orders["w, x, y, z"]]
    elif here > 0.4 or (here > 0.05 and lean[likely] < here / 5):
        guess = f"are its cells in the order {likely}?" if lean[likely] < here / 2 else "is it of another body?"
        raise ValueError(
            f"{table.path}, columns {', '.join(parts)}: the robot would lean by {2 * here:.2f} rad; {guess}"
        )
    x, y, z, w = (quaternion / size[:, None]).T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _lean(quaternion: np.ndarray) -> float:
    """By half of how much a body of these orientations ``[N, 4]`` (x, y, z, w) leans in rad, at a sine's worth."""
    return float(np.quantile(np.hypot(quaternion[:, 0], quaternion[:, 1]), 0.9))


def _finite(table: Table, columns: Columns, *arrays: np.ndarray | None) -> None:
    """Refuse what is not finite, by the row and column."""
    time, samples, heading = arrays
    labelled = {"time": time, **dict(zip(("x", "y") if samples.shape[1] == 2 else (), samples.T, strict=False))}
    labelled |= {} if heading is None else {"heading": heading}
    for name, values in labelled.items():
        wrong = ~np.isfinite(values)
        if wrong.any():
            row = int(wrong.argmax())
            label = columns.name.get(name, name)
            raise ValueError(
                f"{table.path}, {table.at(row)}, column {label}: expected a finite number, got {values[row]}."
            )


def _without_repetitions(
    time: np.ndarray, episode: np.ndarray, samples: np.ndarray, heading: np.ndarray | None
) -> np.ndarray:
    """Which rows ``[N]`` say something that the row before did not."""
    everything = np.column_stack([time, episode, samples, *([] if heading is None else [heading])])
    return np.concatenate([[True], (np.diff(everything, axis=0) != 0).any(1)])


def _scene(
    table: Table,
    columns: Columns,
    reading: Reading,
    kind: str,
    episode: np.ndarray,
    names: list[str],
    notes: list[str],
) -> tuple[dict[str, np.ndarray], dict[int, str]]:
    """Arrays of the scene, one row per episode, and what is wrong with which."""
    boxes = list(dict.fromkeys(match[1] for name in columns.name if (match := re.match(r"(box\d+)_", name))))
    count, problems, scene = len(names), {}, {}
    for name, parts in SCENE_COLUMNS.items():
        given = getattr(reading, name, None)
        if name == "start" and kind == "pose":
            continue
        if isinstance(given, str):  # the end of the drive, which is not known yet
            scene[name] = np.zeros((count, 2))
        elif given is not None:
            scene[name] = np.tile(np.asarray(given, float), (count, 1))
        else:
            scene[name] = np.stack([_constant(table, columns, part, episode, problems) for part in parts], 1)
            spread = max(
                np.nanmax(np.abs(columns[part] - scene[name][episode, i]), initial=0) for i, part in enumerate(parts)
            )
            if spread > 0.001:
                notes.append(f"the {name} lies where it is measured within {spread:.2g} (median)")
    scene["boxes"] = np.full((count, len(boxes), len(BOX)), np.nan)
    for i, box in enumerate(boxes):
        for j, part in enumerate(BOX):
            name, whole = f"{box}_{part}", f"{box}_{part}".replace("half_", "")
            whole_side = part.startswith("half") and name not in columns and whole in columns
            values = _constant(table, columns, whole if whole_side else name, episode, problems, optional=True)
            scene["boxes"][:, i, j] = values / 2 if whole_side else values
        partly = np.isnan(scene["boxes"][:, i]).any(1) & ~np.isnan(scene["boxes"][:, i]).all(1)
        for number in np.flatnonzero(partly):
            problems.setdefault(number, f"episode {names[number]}: {box} needs all of {', '.join(BOX)}, or none")
    return scene, problems


def _constant(
    table: Table, columns: Columns, name: str, episode: np.ndarray, problems: dict[int, str], optional: bool = False
) -> np.ndarray:
    """One value per episode ``[E]``: the median of those that are there, which lie close together."""
    if name not in columns:
        subject = name.partition("_")[0]
        or_else = {"goal": " or --goal X Y or --goal end", "human": " or --human X Y"}.get(subject, "")
        raise ValueError(f"{table.path}: expected a column {name}; {table}; say which it is with --columns {name}=NAME"
                         f"{or_else}.")  # fmt: skip
    values, column, result = columns[name], columns.name[name], []
    for number in range(episode.max() + 1):
        rows = np.flatnonzero(episode == number)
        given = rows[~np.isnan(values[rows])]
        if not len(given):
            if not optional:
                problems.setdefault(number, f"{table.at(rows[0])}, column {column}: expected a number, got nothing")
            result.append(np.nan)
            continue
        here = values[given]
        middle = float(np.median(here))
        off, allowed = np.abs(here - middle), SPREAD.get(name.partition("_")[0], 0.05)
        third = max(1, len(here) // 3)
        drift = np.median(here[-third:]) - np.median(here[:third])
        if name.startswith("human") and abs(drift) > 0.1 and len(here) > 8:
            problems.setdefault(
                number,
                f"{table.at(given[-1])}, column {column}: the human walks by {np.ptp(here):.2g} m, and the world's "
                f"stands; expected one place per episode",
            )
        elif off.max() > allowed:
            first = int((np.abs(here - here[0]) > allowed).argmax())
            first = first if np.abs(here - here[0]).max() > allowed else int(off.argmax())
            problems.setdefault(
                number,
                f"{table.at(given[first])}, column {column}: expected {here[0]:g} as before in this episode, got "
                f"{here[first]:g}",
            )
        result.append(middle)
    return np.array(result)


def _from_motion(file: Trajectories) -> np.ndarray:
    """Headings ``[N]`` in the direction of the motion, which standing still does not change."""
    heading = np.zeros(len(file.time))
    begin, end, course = courses(file, 0.1)
    middle = (file.time[begin] + file.time[end]) / 2
    for number in range(len(file.names)):
        rows = file.rows(number)
        mine = file.episode[begin] == number
        if number in file.problems:
            continue
        if not mine.any():
            file.problems.setdefault(
                number,
                f"{file.table.at(rows[0])}: episode {file.names[number]} does not move, so nothing tells its heading",
            )
            continue
        heading[rows] = _extended(file.time[rows], middle[mine], np.unwrap(course[mine]))
    return heading


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
    for name in ("start", "goal", "human"):
        if name in scene:
            scene[name][:, :2] -= origin
    scene["boxes"][..., :2] -= origin[:, None]
    if file.kind == "pose":
        samples[:, :2] -= origin[file.episode]
    note = f"the origin is laid to ({origin[0, 0]:g}, {origin[0, 1]:g}) m"
    return replace(file, scene=scene, samples=samples, notes=[*file.notes, note])
