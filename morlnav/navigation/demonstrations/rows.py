"""Of tables with several tracks, or rows that tell no pose, those rows that are one robot's drive."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.columns import Reading, choose
from morlnav.navigation.demonstrations.names import TRACK, parse, plain
from morlnav.navigation.demonstrations.table import BLANK, Table


def one_track(table: Table, reading: Reading) -> Table:
    """Of a table with several tracks one below the other, that of the robot, with the person's beside it.

    Tracks are told apart by a column such as ``track_id``, ``ped_id`` or ``id``. A table with one track, or without
    such a column, stays as it is.

    Raises:
        ValueError: listing the tracks, if it is not said who drives, or there is no such track.

    Examples:
        >>> from pathlib import Path
        >>> cells = {"frame": [0, 0, 1, 1], "track_id": [7, 8, 7, 8], "x": [0.0, 3.0, 0.1, 3.0], "y": [0.0] * 4}
        >>> table = Table(Path("f"), {name: pd.Series(cell) for name, cell in cells.items()}, np.arange(4))
        >>> one_track(table, Reading(robot="7", person="8")).columns["human_x"].tolist()
        [3.0, 3.0]
    """
    named = reading.columns.get("track")
    column = named or next((name for name in table.columns if TRACK.fullmatch(plain(name))), None)
    if named is not None and named not in table.columns:
        raise ValueError(f"{table.path}: there is no column {named} that could be track; {table}.")
    ids = None
    if column is not None and (named or column not in reading.columns.values()):
        cells = table.columns[column]
        numbers = pd.to_numeric(cells, errors="coerce")
        ids = (numbers.astype(int) if numbers.notna().all() else cells).astype(str).reset_index(drop=True)
    wanted = {"robot": reading.robot, "person": reading.person}
    if ids is None or (ids.nunique() == 1 and not any(wanted.values())) or (ids.is_unique and reading.robot is None):
        if any(wanted.values()):
            raise ValueError(f"{table.path} holds no column of tracks, such as track_id; {table}.")
        return table
    known = ids.unique().tolist()
    if reading.robot is None:
        raise ValueError(
            f"{table.path}, column {column} tells {len(known)} tracks apart ({_some(known)}); say who drives with "
            f"--robot and who stands in the way with --person, or that these are drives: --columns episode={column}."
        )
    for name, track in wanted.items():
        if track is not None and track not in known:
            raise ValueError(f"{table.path}: there is no track {track} for --{name}; there are {_some(known)}.")
    rows = np.flatnonzero(ids == reading.robot)
    columns = {name: cells.iloc[rows].reset_index(drop=True) for name, cells in table.columns.items() if name != column}
    if reading.person is not None:
        chosen, _ = choose(table, reading)
        moment, theirs = chosen.get("time") or chosen.get("frame"), (ids == reading.person).to_numpy()
        if moment is None:
            raise ValueError(f"{table.path}: tracks side by side need a column time or frame; {table}.")
        for part in ("x", "y"):
            place = pd.Series(table.columns[chosen[part]][theirs].to_numpy(), table.columns[moment][theirs].to_numpy())
            columns[f"human_{part}"] = columns[moment].map(place[~place.index.duplicated()])
    left = len(known) - sum(track is not None for track in wanted.values())
    notes = (*table.notes, f"{left} other tracks are left out") if left else table.notes
    return replace(table, columns=columns, row=table.row[rows], notes=notes)


def _some(names: Sequence[str], most: int = 8) -> str:
    return ", ".join(map(str, names[:most])) + (", …" if len(names) > most else "")


def with_poses(table: Table, reading: Reading) -> Table:
    """The rows of a table that tell a pose, where others are blank for they belong to something else.

    So are the rows of PlotJuggler, and those of a moment in which nothing was tracked. What they say of goal and human
    is carried over to the rows beside them.

    Examples:
        >>> from pathlib import Path
        >>> cells = {"t": ["0", "1", "2"], "x": ["0", "", "1"], "y": ["0", "", "0"], "human_x": ["", "3", ""]}
        >>> table = Table(Path("f"), {name: pd.Series(cell) for name, cell in cells.items()}, np.arange(3))
        >>> kept = with_poses(table, Reading())
        >>> kept.columns["human_x"].tolist(), kept.row.tolist(), kept.notes
        (['3', '3'], [0, 2], ('1 rows without a pose left out',))
    """
    chosen, _ = choose(table, reading)
    pose = [chosen[name] for name in ("x", "y", "heading", *(f"q{part}" for part in "xyzw")) if name in chosen]
    filled = {name: cells.mask(cells.astype(str).str.strip().str.lower().isin(BLANK)) for name, cells in
              table.columns.items() if name in pose or re.match("goal|human", parse(name)[0] or "")}  # fmt: skip
    blank = np.all([filled[name].isna() for name in pose], axis=0) if pose else np.zeros(len(table.row), bool)
    if not blank.any() or blank.all():
        return table
    carried = {name: cells.ffill().bfill() for name, cells in filled.items() if name not in pose}
    columns = {name: cells[~blank].reset_index(drop=True) for name, cells in {**table.columns, **carried}.items()}
    notes = (*table.notes, f"{blank.sum()} rows without a pose left out")
    return replace(table, columns=columns, row=table.row[~blank], notes=notes)
