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


def check_times(file: Trajectories, number: int, reading: Reading) -> None:
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
    largest = max(reading.max_gap or 1.0, 2.5 * float(np.median(step)) if len(step) else 0)
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
        return 0.0, np.nan
    return float(np.median(np.concatenate(steps))), float(np.quantile(np.concatenate(speeds), 0.75))


def check_units(file: Trajectories, columns: Columns, max_speed: float) -> None:
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


def check_heading(file: Trajectories, columns: Columns, heading: np.ndarray) -> None:
    """The robot drives where it looks; else say how its heading may be meant."""
    begin, end, course = courses(file)
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
