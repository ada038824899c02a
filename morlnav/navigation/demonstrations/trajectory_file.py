"""Trajectories in files: what a table of any dialect says about drives and their scenes, and whether it can be true."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.columns import TOPICS, Columns, Reading, one_track, with_poses
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
LONG_STEP = 2.0
"""Seconds between samples that no recording has."""
FURTHEST = 500.0
"""Metres from one end of a drive to the other that no demonstration has."""


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
    if kind == "action" and (reading.heading or reading.goal == "end"):
        raise ValueError(f"{table.path} holds actions, for which headings and ends are not told; leave them out.")
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
            _check_times(file, number, reading)
    if kind == "pose":
        _check_units(file, columns, max_speed)
        heading = _from_motion(file) if heading is None else heading[keep]
        _check_heading(file, columns, heading)
        file = replace(file, samples=np.concatenate([samples, heading[:, None]], 1))
        if reading.goal == "end":
            ends = [file.rows(number)[-1] for number in range(len(names))]
            scene["goal"] = file.samples[ends, :2]
    _check_angles(file, columns)
    _check_distances(file, columns)
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


def _check_times(file: Trajectories, number: int, reading: Reading) -> None:
    """Times grow, without a large gap."""
    rows = file.rows(number)
    if file.kind == "pose" and len(rows) < 2:
        raise ValueError(
            f"{file.table.at(rows[0])}: episode {file.names[number]} has a single pose, expected two or more"
        )
    step = np.diff(file.time[rows])
    late = np.flatnonzero(step <= 0)
    if len(late):
        row, before = rows[late[0] + 1], rows[late[0]]
        guess = "are the rows out of order?"
        if file.time[row] <= file.time[rows[0]] + 1:
            guess = "does another drive begin here? Then number the drives in a column episode"
        raise ValueError(
            f"{file.table.at(row)}, column time: expected more than {file.time[before]:g} s, the time of the row "
            f"before, got {file.time[row]:g} s; {guess}"
        )
    largest = max(reading.max_gap, 2.5 * float(np.median(step)) if len(step) else 0)
    gaps = np.flatnonzero(step > largest)
    if file.kind == "pose" and len(gaps) and np.median(step) <= LONG_STEP:
        raise ValueError(
            f"{file.table.at(rows[gaps[0] + 1])}, column time: nothing is told for {step[gaps[0]]:.3g} s, expected at "
            f"most {largest:g} s between two rows; split the drive there, or allow it with --max-gap"
        )


def _speeds(file: Trajectories) -> tuple[float, float]:
    """Median time between samples in s, and a usual speed of the drive in m/s, over a second or a step if longer."""
    steps, speeds = [], []
    for number in range(len(file.names)):
        rows = file.rows(number)
        time, place = file.time[rows], file.samples[rows, :2]
        if len(rows) < 2 or (np.diff(time) <= 0).any():
            continue
        steps.append(np.diff(time))
        later = np.searchsorted(time, time[:-1] + 1.0 - 1e-6).clip(max=len(rows) - 1)
        later = np.maximum(later, np.arange(1, len(rows)))
        apart = np.linalg.norm(place[later] - place[:-1], axis=1) / (time[later] - time[:-1])
        speeds.append(apart)
    if not speeds:
        return STEP_TIME, np.nan
    return float(np.median(np.concatenate(steps))), float(np.quantile(np.concatenate(speeds), 0.75))


def _check_units(file: Trajectories, columns: Columns, max_speed: float) -> None:
    """Times and lengths can be in seconds and metres; else say in what they may be."""
    step, speed = _speeds(file)
    reach = max(np.ptp(file.samples[file.rows(number), :2], axis=0).max() for number in range(len(file.names)))
    slow, fast = 0.02, 1.5 * max_speed
    if np.isnan(speed) or (step <= LONG_STEP and slow <= speed <= fast and reach <= FURTHEST):
        return
    times, lengths = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}, {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
    possible = {}
    for time, length in product(times, lengths):
        guess = speed * lengths[length] / times[time]
        can_be = 5e-4 <= step * times[time] <= LONG_STEP and reach * lengths[length] <= FURTHEST
        if can_be and slow <= guess <= fast and (time != "min" or speed > 10):
            rare = (time != "s") + (length != "m") + 2 * (step * times[time] < 4e-3)
            possible[time, length] = abs(np.log(guess / (0.7 * max_speed))) + rare
    found = f"rows lie {step:.3g} s apart and the robot drives {speed:.2g} m/s"
    words = {
        "ms": "milliseconds",
        "us": "microseconds",
        "ns": "nanoseconds",
        "min": "minutes",
        "cm": "centimetres",
        "mm": "millimetres",
    }
    if possible:
        time, length = min(possible, key=possible.get)
        asks = [f"is {columns.name.get('time', 'time')} in {words[time]}?"] if time != "s" else []
        asks += [f"are lengths in {words[length]}?"] if length != "m" else []
        units = [f"time={time}"] * (time != "s") + [f"length={length}"] * (length != "m")
        raise ValueError(f"{file.path}: {found}; {' and '.join(asks)} Then: --units {' '.join(units)}.")
    if speed > fast:
        raise ValueError(
            f"{file.path}: {found}, and the robot can {max_speed:g} m/s; set env.world.robot.max_speed=NUMBER for a "
            f"faster one, or --units if lengths or times are in others."
        )


def _courses(file: Trajectories, chord: float = 0.2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where good drives go: pairs of samples ``[S]`` and ``[S]`` some way apart, and the direction between them."""
    begin, end = [], []
    for number in set(range(len(file.names))) - set(file.problems):
        rows = file.rows(number)
        place, last = file.samples[rows, :2], 0
        for i in range(1, len(rows)):
            if np.hypot(*(place[i] - place[last])) >= chord:
                begin.append(rows[last])
                end.append(rows[i])
                last = i
    begin, end = np.array(begin, int), np.array(end, int)
    ahead = file.samples[end, :2] - file.samples[begin, :2]
    return begin, end, np.arctan2(ahead[:, 1], ahead[:, 0])


def _from_motion(file: Trajectories) -> np.ndarray:
    """Headings ``[N]`` in the direction of the motion, which standing still does not change."""
    heading = np.zeros(len(file.time))
    begin, end, course = _courses(file, 0.1)
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


GUESSES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "is it in degrees? Then: --units heading=deg": np.deg2rad,
    "does it count clockwise? Then: --heading clockwise": np.negative,
    "is it a compass's, clockwise from the y axis? Then: --heading compass": lambda h: np.pi / 2 - h,
    "does it drive backwards, which ours cannot? If only its heading is turned: --heading motion": lambda h: h + np.pi,
    "is it counted from the y axis? Then: --heading motion": lambda h: h + np.pi / 2,
    "is it counted from the -y axis? Then: --heading motion": lambda h: h - np.pi / 2,
    "is it in degrees, clockwise? Then: --units heading=deg --heading clockwise": lambda h: -np.deg2rad(h),
    "is it a compass's, in degrees? Then: --units heading=deg --heading compass": lambda h: np.pi / 2 - np.deg2rad(h),
}


def _check_heading(file: Trajectories, columns: Columns, heading: np.ndarray) -> None:
    """The robot drives where it looks; else say how its heading may be meant."""
    begin, end, course = _courses(file)
    if len(begin) < 3:
        return

    def off(angles: np.ndarray) -> float:
        turned = angles[begin] + _wrap(angles[end] - angles[begin]) / 2 - course
        return float(np.median(np.abs(_wrap(turned))))

    here = off(heading)
    best = min(GUESSES, key=lambda guess: off(GUESSES[guess](heading)))
    then = off(GUESSES[best](heading))
    if (here > 0.08 and then < here / 4) or (here > 0.6 and then < 0.3):
        label = columns.name.get("heading", "the quaternion")
        raise ValueError(
            f"{file.path}, column {label}: the robot would look {here:.2f} rad away from where it drives; {best}."
        )


def _wrap(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _check_angles(file: Trajectories, columns: Columns) -> None:
    """Angles of boxes and starts are in radians."""
    angles = {f"box{i + 1}_angle": file.scene["boxes"][:, i, 4] for i in range(file.scene["boxes"].shape[1])}
    if "start" in file.scene:
        angles["start_heading"] = file.scene["start"][:, 2]
    for name, values in angles.items():
        largest = np.nanmax(np.abs(values), initial=0)
        if largest > 2 * np.pi + 0.01 and not columns.unit_is_told(name):
            raise ValueError(
                f"{file.path}, column {columns.name.get(name, name)}: expected an angle in radians, got {largest:g}; "
                f"is it in degrees? Then: --units angle=deg."
            )


def _check_distances(file: Trajectories, columns: Columns) -> None:
    """Goal, human and boxes lie where the robot drives; else say in which unit they may be."""
    if file.kind == "action":
        return
    for name in ("goal", "human", "boxes"):
        places = file.scene[name].reshape(len(file.names), -1, file.scene[name].shape[-1])[..., :2]
        for number in range(len(file.names)):
            drive = file.samples[file.rows(number), :2]
            reach = np.ptp(drive, axis=0).max() + 20
            away = np.linalg.norm(places[number] - drive.mean(0), axis=-1)
            if not (away > reach).any() or (name == "boxes" and not (away < 900).any()):
                continue
            part = {"goal": "goal_x", "human": "human_x", "boxes": "box1_x"}[name]
            beside = drive[-1] if name == "goal" else drive.mean(0)
            guesses = {
                unit: np.linalg.norm(places[number] * factor - beside, axis=-1).max()
                for unit, factor in {"cm": 1e-2, "mm": 1e-3}.items()
            }
            unit = min(guesses, key=guesses.get)
            unit = unit if guesses[unit] <= reach else None
            label = columns.name.get(part, part)
            guess = (
                f"; is it in {unit}? Then: --units {part}={unit} {part[:-1]}y={unit}"
                if unit
                else ("; is it in another frame than the robot?")
            )
            raise ValueError(
                f"{file.path}, column {label}: {name if name != 'boxes' else 'a box'} of episode {file.names[number]} "
                f"lies {np.nanmax(away):.4g} m from the drive{guess}"
            )


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
