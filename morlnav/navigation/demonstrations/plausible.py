"""Whether trajectories can be meant as they are read; sentences that ask where they cannot."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.columns import Columns, Reading
from morlnav.navigation.demonstrations.names import UNITS
from morlnav.navigation.world.geometry import wrap_angle

if TYPE_CHECKING:
    from morlnav.navigation.demonstrations.trajectory_file import Trajectories

LONG_STEP = 2.0
"""Seconds between samples that no recording has."""
FURTHEST = 500.0
"""Metres from one end of a drive to the other that no demonstration has."""
TIMES = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds", "min": "minutes",
         "h": "hours", "d": "days", "cs": "hundredths of a second"}  # fmt: skip
LENGTHS = {"m": "metres", "cm": "centimetres", "mm": "millimetres", "km": "kilometres", "dm": "decimetres",
           "in": "inches", "ft": "feet"}  # fmt: skip
RARE = {"cs", "dm", "in", "ft"}
FASTEST = 3.0
"""Metres per second that some robot may drive."""


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
    is_pose, label = file.kind == "pose", columns.name.get("time", "time")
    _check_seconds(file, columns, label)
    reach = max(np.ptp(file.samples[file.rows(number), :2], axis=0).max() for number in range(len(file.names)))
    slow, fast = 0.02, 1.5 * max_speed
    can_be_so = not is_pose or (slow <= speed <= fast and reach <= FURTHEST)
    if np.isnan(speed) or (can_be_so and step <= max(LONG_STEP, max_gap or 0)):
        return
    found = f"rows lie {step:.3g} s apart" + f" and the robot drives {speed:.2g} m/s" * is_pose
    if can_be_so and is_pose:
        raise ValueError(
            f"{file.path}: {found}; what lies between them is not told, expected at most {LONG_STEP:g} s; allow it "
            f"with --max-gap {np.ceil(step):g}."
        )
    if guess := _guess_units(columns, label, step, speed if is_pose else None, reach, max_speed):
        raise ValueError(f"{file.path}: {found}; {guess}")
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


def _guess_units(
    columns: Columns, label: str, step: float, speed: float | None, reach: float, max_speed: float
) -> str | None:
    """In which other units times and lengths would be those of a drive; ``speed`` is ``None`` for actions."""
    told = [UNITS[of].get(columns.unit(name), 1.0) for of, name in (("time", "time"), ("length", "x"))]
    scores = {}
    for time, length in product(TIMES, LENGTHS if speed is not None else ("m",)):
        seconds, metres = UNITS["time"][time] / told[0], UNITS["length"][length] / told[1]
        same, driven = (seconds == 1, metres == 1), 0.7 * max_speed if speed is None else speed * metres / seconds
        if all(same) or not (5e-4 <= step * seconds <= LONG_STEP and 0.02 <= driven <= 1.5 * max_speed):
            continue
        rare = len({time, length} & RARE)
        if reach * metres > FURTHEST or (seconds > 1 and not (speed or 0) > 10) or (rare and not any(same)):
            continue
        if same[1] or not rare or (speed or 0) > FASTEST:  # a robot may as well be fast as tell feet
            usual = abs(np.log(driven / (0.7 * max_speed))) + 2 * (step * seconds < 4e-3) + rare / 2
            scores[time, length] = usual + (not same[0]) + (not same[1])
    if not scores:
        return None
    time, length = best = min(scores, key=scores.get)
    lengths = [unit for when, unit in scores if when == time and scores[when, unit] < scores[best] + 0.8]
    lengths.sort(key=lambda unit: scores[time, unit])
    asks, units = [], []
    if UNITS["time"][time] != told[0]:
        asks, units = [f"is {label} in {TIMES[time]}?"], [f"time={time}"]
    if UNITS["length"][length] != told[1]:
        asks.append(f"are lengths in {' or '.join(LENGTHS[unit] for unit in lengths)}?")
        units.append(" or ".join(f"length={unit}" for unit in lengths))
    return f"{' and '.join(asks)} Then: --units {' '.join(units)}."


def _check_seconds(file: Trajectories, columns: Columns, label: str) -> None:
    """Times are not numbers of rows, which lie 1 apart."""
    steps = np.concatenate([np.diff(file.time[file.rows(number)]) for number in range(len(file.names))])
    cells = columns.table.columns.get(label)
    if len(steps) < 10 or cells is None or columns.unit("time") or not (steps == 1).all():
        return
    if pd.to_numeric(cells, errors="coerce").notna().all():
        raise ValueError(
            f"{file.path}: rows lie 1 s apart; is {label} their number? Then: --columns frame={label} --rate NUMBER; "
            f"if not: --units time=s."
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


ANGLES = {"rad": "radians", "deg": "degrees", "pi": "half turns", "turn": "turns", "gon": "gon", "mrad": "milliradians",
          "cdeg": "hundredths of a degree"}  # fmt: skip
DIRECTIONS: tuple[tuple[str, str, Callable[[np.ndarray], np.ndarray]], ...] = (
    ("does it count counter-clockwise", "", lambda h: h),
    ("does it count clockwise", "clockwise", np.negative),
    ("is it a compass's, clockwise from the y axis", "compass", lambda h: np.pi / 2 - h),
    ("does it drive backwards, which ours cannot, or is it just turned", "motion", lambda h: h + np.pi),
    ("is it counted from the y axis", "motion", lambda h: h + np.pi / 2),
    ("is it counted from the -y axis", "motion", lambda h: h - np.pi / 2),
)
"""What to ask about headings, the option that says so, and what they are then."""


def check_heading(file: Trajectories, columns: Columns) -> None:
    """The robot drives where it looks; else say how its heading may be meant."""
    begin, end, course = courses(file)
    how, told = columns.reading.heading or "", columns.unit("heading") or "rad"
    if len(begin) < 3 or how == "motion":
        return
    now = next(direction for direction in DIRECTIONS if direction[1] == how)
    plain = now[2](file.samples[:, 2]) / UNITS["angle"][told]  # each direction undoes itself

    def off(unit: str, meant: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        angle = meant(plain * UNITS["angle"][unit])
        turned = angle[begin] + wrap_angle(angle[end] - angle[begin]) / 2 - course
        return np.quantile(np.abs(wrap_angle(turned)), [0.5, 0.9])

    units = ANGLES if "heading" in columns else [told]
    ways = {(unit, way): off(unit, way[2]) for unit, way in product(units, DIRECTIONS) if (unit, way) != (told, now)}
    least = min(then.sum() for then in ways.values())  # of several that fit the usual one comes first
    (unit, way), then = next(found for found in ways.items() if found[1].sum() <= least + 0.03)
    here, bends = off(told, now[2]), np.quantile(np.abs(wrap_angle(course - course[0])), 0.9)
    if here[0] > 0.08 and np.ptp(file.samples[begin, 2]) < 0.02 and bends > 0.3:
        guess = "it never changes, though the drive bends; is it of no use? Then: --heading motion"
    elif ((here > [0.08, 0.2]) & (then < here / 4)).any() or (here[0] > 0.6 and then[0] < 0.3):
        guess = _guess_heading("" if unit == told else unit, None if way[1] == how else way[0], way[1])
    else:
        return
    label = columns.name.get("heading", "the quaternion")
    raise ValueError(
        f"{file.path}, column {label}: the robot would look {here.max():.2f} rad away from where it drives; {guess}."
    )


def _guess_heading(unit: str, question: str | None, option: str) -> str:
    asks = [f"is it in {ANGLES[unit]}"] if unit else []
    asks += [question] if question else []
    options = [f"--units heading={unit}"] if unit and option != "motion" else []
    options += [f"--heading {option}"] if option else []
    return f"{' and '.join(asks)}? Then: {' '.join(options) or 'leave --heading out'}"
