"""Whether trajectories can be meant as they are read; sentences that ask where they cannot."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from morlnav.navigation.demonstrations.columns import Columns, Reading

if TYPE_CHECKING:
    from morlnav.navigation.demonstrations.trajectory_file import Trajectories

LONG_STEP = 2.0
"""Seconds between samples that no recording has."""
FURTHEST = 500.0
"""Metres from one end of a drive to the other that no demonstration has."""
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3}
WORDS = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds", "min": "minutes", "h": "hours", "d": "days",
         "cm": "centimetres", "mm": "millimetres", "km": "kilometres"}  # fmt: skip


def check_times(file: Trajectories, number: int, reading: Reading) -> None:
    """Times grow, without a large gap."""
    rows, is_pose = file.rows(number), file.kind == "pose"
    if is_pose and len(rows) < 2:
        raise ValueError(
            f"{file.table.at(rows[0])}: episode {file.names[number]} has a single pose, expected two or more"
        )
    step = np.diff(file.time[rows])
    late = np.flatnonzero(step <= 0)
    if len(late):
        row, before = rows[late[0] + 1], rows[late[0]]
        raise ValueError(
            f"{file.table.at(row)}, column time: expected more than {file.time[before]:g} s, the time of the row "
            f"before, got {file.time[row]:g} s; {_guess_late(file.time[rows], late)}"
        )
    if not len(step):
        return
    median = float(np.median(step))
    largest = max(reading.max_gap or (1.0 if is_pose else LONG_STEP), 2.5 * median)
    gaps = np.flatnonzero(step > largest)
    if len(gaps) and median <= LONG_STEP:
        raise ValueError(
            f"{file.table.at(rows[gaps[0] + 1])}, column time: nothing is told for {step[gaps[0]]:.3g} s, expected at "
            f"most {largest:g} s between two rows; split the drive there{', or allow it with --max-gap' * is_pose}"
        )


def _guess_late(time: np.ndarray, late: np.ndarray) -> str:
    """What may be meant by times ``[N]`` that do not grow after some samples."""
    step = np.diff(time)[late]
    if step[0] == 0:
        return "are times rounded, in single precision, or of several robots?"
    if len(late) > len(time) / 4 or time[late[0] + 1] > time[0] + 1:
        return "are the rows out of order?"
    if len(late) == 1 and abs(step[0] + 86400) < 3600:
        return "do times of day pass midnight? Then tell dates, too"
    return "does another drive begin here? Then number the drives in a column episode"


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
        return 0.0, np.nan
    return float(np.median(np.concatenate(steps))), float(np.quantile(np.concatenate(speeds), 0.75))


def check_units(file: Trajectories, columns: Columns, max_speed: float, max_gap: float | None = None) -> None:
    """Times and lengths can be in seconds and metres; else say in what they may be.

    Args:
        file: of poses or actions.
        columns: that it was read from.
        max_speed: of the robot in m/s.
        max_gap: longest time between samples that was allowed.
    """
    step, speed = _speeds(file)
    is_pose = file.kind == "pose"
    reach = max(np.ptp(file.samples[file.rows(number), :2], axis=0).max() for number in range(len(file.names)))
    slow, fast = 0.02, 1.5 * max_speed
    can_be_so = not is_pose or (slow <= speed <= fast and reach <= FURTHEST)
    if np.isnan(speed) or (can_be_so and step <= max(LONG_STEP, max_gap or 0)):
        return
    time_label = columns.name.get("time", "time")
    found = f"rows lie {step:.3g} s apart" + f" and the robot drives {speed:.2g} m/s" * is_pose
    possible = {}
    for time, length in product(TIMES, LENGTHS if is_pose else ("m",)):
        factor, apart = LENGTHS[length], step * TIMES[time]
        guess = speed * factor / TIMES[time] if is_pose else 0.7 * max_speed
        can_be = 5e-4 <= apart <= LONG_STEP and reach * factor <= FURTHEST and (time, length) != ("s", "m")
        if can_be and slow <= guess <= fast and (TIMES[time] <= 1 or speed > 10):
            rare = (time != "s") + (length != "m") + 2 * (apart < 4e-3)
            possible[time, length] = abs(np.log(guess / (0.7 * max_speed))) + rare
    if can_be_so and is_pose:
        raise ValueError(
            f"{file.path}: {found}; what lies between them is not told, expected at most {LONG_STEP:g} s; allow it "
            f"with --max-gap {np.ceil(step):g}."
        )
    if possible:
        time, length = min(possible, key=possible.get)
        asks = [f"is {time_label} in {WORDS[time]}?"] if time != "s" else []
        asks += [f"are lengths in {WORDS[length]}?"] if length != "m" else []
        units = [f"time={time}"] * (time != "s") + [f"length={length}"] * (length != "m")
        raise ValueError(f"{file.path}: {found}; {' and '.join(asks)} Then: --units {' '.join(units)}.")
    if is_pose and 0 < reach < 0.05:
        raise ValueError(
            f"{file.path}: {found}, {reach:.1g} m in all; are these degrees of latitude and longitude? They have to "
            f"become metres first, as of UTM."
        )
    if is_pose and speed > fast:
        raise ValueError(
            f"{file.path}: {found}, and the robot can {max_speed:g} m/s; set env.world.robot.max_speed=NUMBER for a "
            f"faster one, or --units if lengths or times are in others."
        )


def courses(file: Trajectories, chord: float = 0.2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


def check_heading(file: Trajectories, columns: Columns) -> None:
    """The robot drives where it looks; else say how its heading may be meant."""
    (begin, end, course), heading = courses(file), file.samples[:, 2]
    if len(begin) < 3:
        return

    def off(angles: np.ndarray) -> float:
        turned = angles[begin] + _wrap(angles[end] - angles[begin]) / 2 - course
        return float(np.median(np.abs(_wrap(turned))))

    here = off(heading)
    best = min(GUESSES, key=lambda guess: off(GUESSES[guess](heading)))
    then = off(GUESSES[best](heading))
    bends = np.quantile(np.abs(_wrap(course - course[0])), 0.9)
    if here > 0.08 and np.ptp(heading[begin]) < 0.02 and bends > 0.3:
        best, then = "it never changes, though the drive bends; is it of no use? Then: --heading motion", 0.0
    if (here > 0.08 and then < here / 4) or (here > 0.6 and then < 0.3):
        label = columns.name.get("heading", "the quaternion")
        raise ValueError(
            f"{file.path}, column {label}: the robot would look {here:.2f} rad away from where it drives; {best}."
        )


def _wrap(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def check_angles(file: Trajectories, columns: Columns) -> None:
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


def check_distances(file: Trajectories, columns: Columns) -> None:
    """Goal, human and boxes lie where the robot drives; else say in which unit they may be."""
    if file.kind == "action":
        return
    for name, part in (("goal", "goal_x"), ("human", "human_x"), ("boxes", "box1_x")):
        far = {}
        for number in range(len(file.names)):
            places, drive = file.scene[name][number].reshape(-1, file.scene[name].shape[-1])[:, :2], file.samples[:, :2]
            drive = drive[file.rows(number)]
            reach = np.ptp(drive, axis=0).max() + 20
            away = np.linalg.norm(places - drive.mean(0), axis=-1)
            if not (away > reach).any() or (name == "boxes" and not (away < 900).any()):
                continue
            beside, guess = drive[-1] if name == "goal" else drive.mean(0), "is it in another frame than the robot?"
            guesses = {unit: np.linalg.norm(places * LENGTHS[unit] - beside, axis=-1).max() for unit in ("cm", "mm")}
            unit = min(guesses, key=guesses.get)
            given = name != "boxes" and getattr(columns.reading, name) is not None
            if guesses[unit] <= reach and not columns.unit_is_told(part) and not given:
                guess = f"is it in {unit}? Then: --units {part}={unit} {part[:-1]}y={unit}"
            label, what = columns.name.get(part, part), "a box" if name == "boxes" else name
            far[number] = (
                f"{f'--{name}' if given else f'column {label}'}: {what} of episode {file.names[number]} lies "
                f"{np.nanmax(away):.4g} m from the drive; {guess}"
            )
        if len(far) == len(file.names):  # a matter of the file
            raise ValueError(f"{file.path}, {far[0]}")
        for number, problem in far.items():
            file.problems.setdefault(number, problem)
