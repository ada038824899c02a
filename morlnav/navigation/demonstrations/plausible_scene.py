"""Whether the scene of trajectories can be meant as it is read; sentences that ask where it cannot."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from morlnav.navigation.demonstrations.columns import Columns
from morlnav.navigation.demonstrations.names import UNITS
from morlnav.navigation.demonstrations.plausible import LENGTHS

if TYPE_CHECKING:
    from morlnav.navigation.demonstrations.trajectory_file import Trajectories

SIZES = (0.02, 25.0)
"""Least and largest half side of a box, in metres."""


def check_angles(file: Trajectories, columns: Columns) -> None:
    """Angles of boxes and starts are in radians, which are no whole numbers."""
    parts = r"box\d+_angle" + "|start_heading" * (file.kind == "action")
    found = {name: np.abs(columns[name]) for name in columns.name if re.fullmatch(parts, name)}
    sizes = {name: size[size > 0] for name, size in found.items() if (size > 0).any() and not columns.unit(name)}
    for name, size in sizes.items():
        beyond = size.max() > 2 * np.pi + 0.01
        like_degrees = (size % 1 == 0).all() or UNITS["angle"].get(columns.unit("heading")) == UNITS["angle"]["deg"]
        if beyond or like_degrees:  # all of them at once, and not the heading, which may be in radians
            degrees, radians = (" ".join(f"{each}={unit}" for each in sizes) for unit in ("deg", "rad"))
            raise ValueError(
                f"{file.path}, column {columns.name[name]}: expected an angle in radians, got {size.max():g}; is it in "
                f"degrees? Then: --units {degrees}{'' if beyond else f'; if not: --units {radians}'}."
            )


def check_sizes(file: Trajectories, columns: Columns) -> None:
    """Sides of boxes are in metres."""
    for name in [name for name in columns.name if re.fullmatch(r"box\d+_(half_)?(length|width)", name)]:
        sides = columns[name]
        sides = sides[sides > 0]
        if columns.unit(name) or not len(sides) or (SIZES[0] <= sides.min() and sides.max() <= SIZES[1]):
            continue
        wrong = sides.max() if sides.max() > SIZES[1] else sides.min()
        unit = min(("cm", "mm", "km"), key=lambda unit: abs(np.log(2 * wrong * UNITS["length"][unit])))
        raise ValueError(
            f"{file.path}, column {columns.name[name]}: expected a box's side in metres, got {wrong:g}; is it in "
            f"{LENGTHS[unit]}? Then: --units {name}={unit}; if not: --units {name}=m."
        )


@np.errstate(over="ignore")
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
            guesses = {unit: np.linalg.norm(places * UNITS["length"][unit] - beside, axis=-1).max()
                       for unit in ("cm", "mm", "ft", "in")}  # fmt: skip
            unit = min(guesses, key=guesses.get)
            given = name != "boxes" and getattr(columns.reading, name) is not None
            if guesses[unit] <= (1.5 if name == "goal" else reach) and not columns.unit(part) and not given:
                guess = f"is it in {LENGTHS[unit]}? Then: --units {part}={unit} {part[:-1]}y={unit}"
            label, what = columns.name.get(part, part), "a box" if name == "boxes" else name
            far[number] = (
                f"{f'--{name}' if given else f'column {label}'}: {what} of episode {file.names[number]} lies "
                f"{np.nanmax(away):.4g} m from the drive; {guess}"
            )
        if len(far) == len(file.names):  # a matter of the file
            raise ValueError(f"{file.path}, {far[0]}{'' if far[0].endswith('?') else '.'}")
        for number, problem in far.items():
            file.problems.setdefault(number, problem)
