"""Which column of a table is what, and in which unit: as the names say, or as somebody says who knows."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pandas as pd

from morlnav.config import nearest
from morlnav.navigation.demonstrations.names import EPISODE, KINDS, SCENE, UNITS, kind, parse, plain
from morlnav.navigation.demonstrations.table import Table

CORNER = re.compile(r"(^|_)(box|boxes|obstacle|obst|wall)s?_?\d*_(.*_)?(min_?|max_?)?[xy](_?(min|max|\d))?(_|$)")
"""Places of something like a box, by its corners or in other words."""
TOPICS = ("pose", "goal", "human", "scan")
"""Parts of a bag."""


@dataclass(frozen=True)
class Reading:
    """How to read files of trajectories, as far as they do not tell; everything has a default that is told or asked.

    Args:
        columns: the file's name for ``time``, ``episode``, ``x``, ``y``, ``heading``, ``v``, ``omega``, ``qx`` …
            ``qw``, or of the scene, as ``goal_x``; of a bag, topics for ``pose``, ``goal``, ``human`` and ``scan``.
        units: of a column or of all of a kind: ``time``, ``length``, ``angle``, ``speed``, ``turn``; they go before
            those in a header.
        separator: between fields, such as ``";"``.
        decimal: sign, ``"."`` or ``","``.
        names: of all columns, for a text without a header.
        rate: samples per second, for files without times or with numbers of frames.
        heading: ``"motion"`` takes the direction of the drive, ``"clockwise"`` turns the sign, ``"compass"`` is
            clockwise from the y axis; by default as the file says, counter-clockwise from the x axis.
        goal: ``(x, y)`` in metres, in the place of columns; ``"end"``: where the drive ends.
        human: ``(x, y)`` in metres, in the place of columns; ``"scan"``: of a bag, where its scans see one.
        robot: id of the track that drives, in a file of several.
        person: id of the track that stands in the way.
        max_gap: longest time without a sample, in seconds (1 by default).

    Raises:
        ValueError: for names and units that nothing is known of.

    Examples:
        >>> Reading(units={"time": "ms", "heading": "deg"}).units["time"]
        'ms'
        >>> Reading(units={"time": "hours"})
        Traceback (most recent call last):
        ValueError: units: time is in s, sec, secs, second, seconds, ms, msec, millis, ... got hours.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    separator: str | None = None
    decimal: Literal[".", ","] | None = None
    names: Sequence[str] | None = None
    rate: float | None = None
    heading: Literal["motion", "clockwise", "compass"] | None = None
    goal: tuple[float, float] | Literal["end"] | None = None
    human: tuple[float, float] | Literal["scan"] | None = None
    robot: str | None = None
    person: str | None = None
    max_gap: float | None = None

    def __post_init__(self) -> None:
        for name in self.columns:
            if kind(name) is None and name not in (*TOPICS, "episode", "nanosec", "frame", "track"):
                raise ValueError(f"columns: there is no {name}; {nearest(name, ('episode', *KINDS, *SCENE))}")
        for name, unit in self.units.items():
            of = name if name in UNITS else kind(name)
            if of is None:
                raise ValueError(f"units: there is no {name}; {nearest(name, (*UNITS, *KINDS, *SCENE))}")
            if unit not in UNITS[of]:
                raise ValueError(f"units: {name} is in {', '.join(list(UNITS[of])[:8])}, ... got {unit}.")
        if self.separator is not None and len(self.separator) != 1:
            raise ValueError(f"separator must be one sign, got {self.separator!r}.")
        for name in ("rate", "max_gap"):
            if getattr(self, name) is not None and not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}.")
        for name in ("goal", "human"):
            place = getattr(self, name)
            if not isinstance(place, str | None) and not np.isfinite(np.asarray(place, float)).all():
                raise ValueError(f"{name} must be two finite numbers, got {place}.")
        if self.heading not in (None, "motion", "clockwise", "compass"):
            raise ValueError(f"heading must be motion, clockwise or compass, got {self.heading}.")


class Columns:
    """The columns of a table by their canonical names, read when they are asked for, in s, m, rad, m/s and rad/s.

    They are found by their usual names, or by those that ``reading`` gives.

    Args:
        table: as :func:`~morlnav.navigation.demonstrations.tables.read_table` returns it.
        reading: what is known beforehand.

    Raises:
        ValueError: listing the table's columns, if one that was named is not there, or two could be the same; and for
            a cell that is no number, when it is asked for.

    Examples:
        >>> from pathlib import Path
        >>> cells = {"stamp [ms]": [0, 200], "posX": [0.0, 0.1], "pos_y": [0.0, 0.0], "Yaw_deg": [0.0, 90.0]}
        >>> table = Table(Path("f"), {name: pd.Series(cell) for name, cell in cells.items()}, np.arange(2))
        >>> found = Columns(table, Reading())
        >>> found["time"].tolist(), found["heading"].round(2).tolist(), "goal_x" in found
        ([0.0, 0.2], [0.0, 1.57], False)
        >>> found.used, found.ignored
        (['stamp [ms]', 'Yaw_deg'], ['posX', 'pos_y'])
    """

    def __init__(self, table: Table, reading: Reading) -> None:
        self.table, self.reading = table, reading
        self.name, self._units = choose(table, reading)
        found = [name for name in table.columns
                 if name not in self.name.values() and EPISODE.fullmatch(plain(name))]  # fmt: skip
        self.episodes = [self.name["episode"]] if "episode" in self.name else found
        self._read: dict[str, None] = {}

    def __contains__(self, name: str) -> bool:
        return name in self.name

    def __getitem__(self, name: str) -> np.ndarray:
        """A column as ``float64`` ``[N]``; cells of the scene may be blank, which become NaN."""
        column = self.name[name]
        self._read[column] = None
        of = kind(name)
        if of == "time" and (dates := _dates(self.table, column)) is not None:
            return dates
        numbers = self.table.numbers(column, blank=name.startswith(("goal", "human", "start", "box")))
        if of == "time" or name == "frame":
            numbers = numbers - numbers.min()  # while they are whole
        unit = self.unit(name)
        if not of or unit is None:
            return numbers.astype(float)
        if unit not in UNITS[of]:
            raise ValueError(
                f"{self.table.path}, column {column}: {unit} is no unit of {of}; say which it is with --units "
                f"{name}=UNIT, one of {', '.join(UNITS[of])}."
            )
        return numbers * UNITS[of][unit]

    def unit(self, name: str) -> str | None:
        """The unit of a column, if the reading or its header tell one."""
        units = self.reading.units
        return units.get(name) or units.get(kind(name)) or self._units.get(name)

    def ids(self) -> np.ndarray | None:
        """What tells episodes apart ``[N]``: the text of a column, or of several side by side; ``None`` without one.

        Raises:
            ValueError: for an empty cell.
        """
        parts = []
        for name in self.episodes:
            self._read[name] = None
            cells = self.table.columns[name]
            blank = cells.isna() | (cells.astype(str).str.strip() == "")
            if blank.any():
                raise ValueError(
                    f"{self.table.path}, {self.table.at(int(blank.to_numpy().argmax()))}, column {name}: expected the "
                    f"name or number of an episode, got nothing."
                )
            whole = pd.api.types.is_numeric_dtype(cells) and (cells % 1 == 0).all()
            parts.append((cells.astype(int) if whole else cells).astype(str))
        return None if not parts else pd.concat(parts, axis=1).agg(" ".join, axis=1).to_numpy()

    def check_all_is_used(self) -> None:
        """Refuse a column or unit that was named and that nothing was read from, and boxes told in another way.

        Raises:
            ValueError: naming it.
        """
        corners = [name for name in self.ignored if CORNER.search(plain(name))]
        if corners and not any(name.startswith("box") for name in self.name):
            raise ValueError(
                f"{self.table.path}: {', '.join(corners)} tell of a box, which is read from box1_x, box1_y, "
                f"box1_half_length, box1_half_width and box1_angle; write it so, or leave the columns out."
            )
        for name in (*self.reading.columns, *self.reading.units):
            if name not in UNITS and name != "track" and self.name.get(name) not in {*self._read}:
                raise ValueError(f"{self.table.path}: {name} is named and not read; read are {', '.join(self._read)}.")

    @property
    def used(self) -> list[str]:
        """The table's names of the columns that were read."""
        return list(self._read)

    @property
    def ignored(self) -> list[str]:
        """The others."""
        return [name for name in self.table.columns if name not in self._read]


def choose(table: Table, reading: Reading) -> tuple[dict[str, str], dict[str, str]]:
    """Columns of the table by canonical name, and the units that stand in their names or in a row of their own."""
    parsed = {column: parse(column) for column in table.columns}
    told = {column: table.units.get(column) or unit for column, (_, unit) in parsed.items()}
    chosen = {}
    for name, column in reading.columns.items():
        found = [own for own in table.columns if own == column] or [
            own for own in table.columns if plain(own) == plain(column)
        ]
        if not found:
            raise ValueError(f"{table.path}: there is no column {column} that could be {name}; {table}.")
        if found[0] in chosen.values():
            raise ValueError(f"{table.path}: column {found[0]} is given for {name}, and for another one.")
        chosen[name] = found[0]
    candidates, humans = {}, set()
    for column, (name, _) in parsed.items():
        if name is not None and column not in chosen.values():
            one = re.sub(r"^human\d+", "human", name)
            humans |= {name.partition("_")[0]} if one.startswith("human") else set()
            candidates.setdefault(one, []).append(column)
    for name in [name for name in candidates if name not in chosen]:
        found = [column for column in candidates[name] if plain(column) == name] or candidates[name]
        if name.startswith("human") and len(humans) > 1 and reading.human is None:
            raise ValueError(
                f"{table.path} holds {len(humans)} humans, and the world knows one; name whose columns to take, as in "
                f"--columns human_x={candidates[name][-1]}; {table}."
            )
        if len(found) > 1:
            raise ValueError(f"{table.path}: {name} could be {' or '.join(found)}; choose with --columns {name}=NAME.")
        chosen[name] = found[0]
    for name in [name for name in chosen if re.fullmatch(r"box\d+_(length|width)", name)]:
        if re.sub("length|width", r"half_\g<0>", name) in chosen:
            del chosen[name]
    return chosen, {name: unit for name, column in chosen.items() if (unit := told[column])}


def _dates(table: Table, column: str) -> np.ndarray | None:
    """Dates and times of day as seconds ``[N]``; ``None`` for cells that are numbers."""
    cells = table.columns[column]
    if pd.api.types.is_numeric_dtype(cells) or pd.to_numeric(cells.astype(str), errors="coerce").notna().any():
        return None
    if cells.dtype.kind not in "mM":
        cells = cells.astype(str).str.strip().str.replace(r"(?<=\d),(?=\d+$)", ".", regex=True)
        if cells.str.fullmatch(r"\d+:\d+\.\d+").mean() > 0.5:
            cells = "00:" + cells  # minutes and seconds
    with warnings.catch_warnings(action="ignore"):  # of pandas, which would rather be told the format
        ways = [pd.to_timedelta(cells, errors="coerce")] if cells.dtype.kind != "M" else []
        ways += [pd.to_datetime(cells, utc=True, errors="coerce", **how) for how in ({"format": "ISO8601"}, {})]
    times = max(ways, key=lambda way: way.notna().sum())
    if times.isna().mean() > 0.5:
        return None
    if times.isna().any():
        row = int(times.isna().to_numpy().argmax())
        raise ValueError(f"{table.path}, {table.at(row)}, column {column}: expected a time, got {cells[row]!r}.")
    return (times - times.min()).dt.total_seconds().to_numpy(float)
