"""Which column of a table is what, and in which unit: from names that people use, or as they say."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pandas as pd

from morlnav.config import nearest
from morlnav.navigation.demonstrations.table import BLANK, Table

UNITS = {
    "time": {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3,
             "millis": 1e-3, "milliseconds": 1e-3, "us": 1e-6, "µs": 1e-6, "usec": 1e-6, "micros": 1e-6,
             "microseconds": 1e-6, "ns": 1e-9, "nsec": 1e-9, "nsecs": 1e-9, "nanosec": 1e-9, "nanoseconds": 1e-9,
             "min": 60.0},
    "length": {"m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "cm": 1e-2, "mm": 1e-3,
               "km": 1e3, "dm": 0.1, "ft": 0.3048, "in": 0.0254},
    "angle": {"rad": 1.0, "radian": 1.0, "radians": 1.0, "deg": np.pi / 180, "degree": np.pi / 180,
              "degrees": np.pi / 180, "°": np.pi / 180, "mrad": 1e-3},
    "speed": {"m/s": 1.0, "mps": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "kph": 1 / 3.6},
    "turn": {"rad/s": 1.0, "radps": 1.0, "deg/s": np.pi / 180, "°/s": np.pi / 180, "dps": np.pi / 180},
}  # fmt: skip
"""Factors to s, m, rad, m/s and rad/s."""

NAMES = {
    "time": "time t times timestamp timestamps stamp ts sec secs seconds elapsed elapsed_time time_stamp clock "
    "rosbag_timestamp unix unixtime unix_time epoch datetime date_time log_time sim_time rel_time zeit stamp_s",
    "nanosec": "nanosec nanosecs nsec nsecs nanoseconds stamp_nanosec stamp_nsecs stamp_nsec",
    "stamp_sec": "stamp_sec stamp_secs",
    "frame": "frame frames frame_number frame_no frame_idx frame_index seq tick step",
    "x": "x px x_pos easting",
    "y": "y py y_pos northing",
    "heading": "heading yaw theta th phi psi θ φ ψ orientation rotation angle yaw_angle heading_angle azimuth bearing "
    "course direction compass rot orientation_yaw rotation_yaw",
    **{
        f"q{part}": f"q{part} q_{part} quat_{part} quaternion_{part} orientation_{part} rotation_{part} rot_{part}"
        for part in "xyzw0123"
    },
    "v": "v vel speed velocity linear linear_velocity lin_vel v_lin vel_lin linear_x linear_vel vx vel_x v_x "
    "forward_speed linear_speed velocity_linear velocity_linear_x cmd_v",
    "omega": "omega w ω angular angular_velocity ang_vel yaw_rate yawrate turn_rate angular_z wz w_z omega_z "
    "angular_speed velocity_angular velocity_angular_z theta_dot heading_rate vel_theta cmd_w",
    "length": "length len size_x l",
    "width": "width size_y",
    "half_length": "half_length",
    "half_width": "half_width",
}
KNOWN = {name: part for part, names in NAMES.items() for name in names.split()}
EPISODE = re.compile(
    r"(?:(?:episode|ep|trial|run|traj|trajectory|drive|demo|demonstration|session|rollout|scenario|take|recording|bag|"
    r"experiment|lap)s?)(?:_?(?:id|ids|index|idx|no|nr|num|number|name|uuid|key))?"
)
TRACK = re.compile(r"(?:track|ped|pedestrian|person|agent|object|actor|human)_?(?:id|index|no|number)|id|agent|p")
SUBJECTS = {"goal": "goal target destination dest", "start": "start initial init",
            "human": "human person ped pedestrian people humans", "box": "box obstacle obst boxes"}  # fmt: skip
OF_SUBJECT = {word: subject for subject, words in SUBJECTS.items() for word in words.split()}
FILLING = frozenset(
    "robot base ego pose pos position positions odom odometry field map world msg message header data value link tf "  # noqa: SIM905
    "footprint amcl translation transform point global local geometry center centre centroid loc location coord ros "
    "coordinate coordinates twist cmd state stamped with covariance current actual true est".split()
)


TOPICS = ("pose", "goal", "human", "scan")
"""Parts of a bag."""


@dataclass(frozen=True)
class Reading:
    """How to read files of trajectories, as far as they do not tell; everything has a default that is told or asked.

    Args:
        columns: the file's name for ``time``, ``episode``, ``x``, ``y``, ``heading``, ``v``, ``omega``, ``qx`` …
            ``qw``, or a column of the scene such as ``goal_x``; of a bag, topics for ``pose``, ``goal``, ``human`` and
            ``scan``.
        units: of a column or of all of a kind: ``time``, ``length``, ``angle``, ``speed``, ``turn``. They go before
            units that stand in a header, as in ``x [mm]`` or ``yaw_deg``.
        separator: between fields, such as ``";"``.
        decimal: sign, ``"."`` or ``","``.
        names: of all columns, for a text without a header.
        rate: samples per second, for files without times or with numbers of frames.
        heading: where it comes from, and how it counts: ``"motion"`` takes the direction of the drive, ``"clockwise"``
            turns the sign, ``"compass"`` is clockwise from the y axis; by default as the file says, counter-clockwise
            from the x axis.
        goal: ``(x, y)`` in metres, in the place of columns; ``"end"``: where the drive ends.
        human: ``(x, y)`` in metres, in the place of columns; ``"scan"``: of a bag, where its scans see one.
        robot: id of the track that drives, of a file of several tracks; see ``person``.
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
            if _kind(name) is None and name not in (*TOPICS, "episode", "nanosec", "frame", "track"):
                known = ("time", "episode", *(part for part in NAMES if part in _KINDS), *_SCENE)
                raise ValueError(f"columns: there is no {name}; {nearest(name, known)}")
        for name, unit in self.units.items():
            kind = name if name in UNITS else _kind(name)
            if kind is None:
                raise ValueError(f"units: there is no {name}; {nearest(name, (*UNITS, *_KINDS, *_SCENE))}")
            if unit not in UNITS[kind]:
                raise ValueError(f"units: {name} is in {', '.join(list(UNITS[kind])[:8])}, ... got {unit}.")
        for name in ("rate", "max_gap"):
            if getattr(self, name) is not None and not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}.")
        if self.heading not in (None, "motion", "clockwise", "compass"):
            raise ValueError(f"heading must be motion, clockwise or compass, got {self.heading}.")


_KINDS = {"time": "time", "x": "length", "y": "length", "heading": "angle", "v": "speed", "omega": "turn",
          **{f"q{part}": "" for part in "xyzw"}}  # fmt: skip
_SCENE = tuple(f"{subject}_{part}" for subject in ("goal", "human", "start") for part in ("x", "y"))


def _kind(name: str) -> str | None:
    """What is measured in a column; ``""`` for pure numbers, ``None`` for unknown names."""
    if name in _KINDS:
        return _KINDS[name]
    subject, _, part = name.partition("_")
    if re.fullmatch(r"goal|human|start|box\d+", subject):
        is_angle = part in (("heading",) if subject == "start" else ("angle",) if subject.startswith("box") else ())
        lengths = ("x", "y", *(("half_length", "half_width", "length", "width") if subject.startswith("box") else ()))
        return "angle" if is_angle else "length" if part in lengths else None
    return None


class Columns:
    """The columns of a table by their canonical names, read when they are asked for, in s, m, rad, m/s and rad/s.

    They are found by their usual names, or by those that ``reading`` gives.

    Args:
        table: as :func:`~morlnav.navigation.demonstrations.table.read_table` returns it.
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
        self.name, self._units = _choose(table, reading)
        found = [name for name in table.columns
                 if name not in self.name.values() and EPISODE.fullmatch(_normal(name))]  # fmt: skip
        self.episodes = [self.name["episode"]] if "episode" in self.name else found
        self._read: dict[str, None] = {}

    def __contains__(self, name: str) -> bool:
        return name in self.name

    def __getitem__(self, name: str) -> np.ndarray:
        """A column as ``float64`` ``[N]``; cells of the scene may be blank, which become NaN."""
        column = self.name[name]
        self._read[column] = None
        kind = {"stamp_sec": "time"}.get(name, _kind(name))
        if kind == "time" and (dates := _dates(self.table.columns[column])) is not None:
            return dates
        numbers = self.table.numbers(column, blank=name.startswith(("goal", "human", "start", "box")))
        if kind == "time" or name == "frame":
            numbers = numbers - numbers.min()  # while they are whole
        return numbers.astype(float) * self._factor(name, kind)

    def _factor(self, name: str, kind: str | None) -> float:
        unit = self.reading.units.get(name) or self.reading.units.get(kind) or self._units.get(name)
        if not kind or unit is None:
            return 1.0
        if unit not in UNITS[kind]:
            raise ValueError(
                f"{self.table.path}, column {self.name[name]}: {unit} is no unit of {kind}; choose from: "
                f"{', '.join(UNITS[kind])}."
            )
        return UNITS[kind][unit]

    def unit_is_told(self, name: str) -> bool:
        """Whether header or reading say in which unit a column is."""
        return bool({name, _kind(name)} & set(self.reading.units) or self._units.get(name))

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
            whole = cells.dtype != object and (cells % 1 == 0).all()
            parts.append((cells.astype(int) if whole else cells).astype(str))
        return None if not parts else pd.concat(parts, axis=1).agg(" ".join, axis=1).to_numpy()

    def check_all_is_used(self) -> None:
        """Refuse a column or unit that was named and that nothing was read from.

        Raises:
            ValueError: naming it.
        """
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


def _choose(table: Table, reading: Reading) -> tuple[dict[str, str], dict[str, str]]:
    """Columns of the table by canonical name, and the units that stand in their names."""
    chosen, units, candidates = {}, {}, {}
    for name, column in reading.columns.items():
        found = [own for own in table.columns if own == column] or [
            own for own in table.columns if _normal(own) == _normal(column)
        ]
        if not found:
            raise ValueError(f"{table.path}: there is no column {column} that could be {name}; {table}.")
        chosen[name] = found[0]
        units[name] = _parse(found[0])[1]
    humans: dict[str, set[str]] = {}
    for column in table.columns:
        canonical, unit = _parse(column)
        if canonical is None or column in chosen.values():
            continue
        if match := re.fullmatch(r"human(\d*)_(.+)", canonical):
            humans.setdefault(match[1], set()).add(column)
            canonical = f"human_{match[2]}"
        candidates.setdefault(canonical, []).append((column, unit))
    for name, found in candidates.items():
        if name in chosen:
            continue
        exact = [entry for entry in found if _normal(entry[0]) == name] or found
        if name.startswith("human") and len(humans) > 1 and reading.human is None:
            raise ValueError(
                f"{table.path} holds {len(humans)} humans, and the world knows one; name whose columns to take, as in "
                f"--columns human_x={found[-1][0]}; {table}."
            )
        if len(exact) > 1:
            raise ValueError(
                f"{table.path}: {name} could be {' or '.join(column for column, _ in exact)}; "
                f"choose with --columns {name}=NAME."
            )
        chosen[name], units[name] = exact[0]
    for part in ("length", "width"):
        for name in [name for name in chosen if re.fullmatch(rf"box\d+_{part}", name)]:
            if name.replace(part, f"half_{part}") in chosen:
                del chosen[name]
    return chosen, units


def _normal(name: str) -> str:
    """``"goalX"`` and ``"Goal x"`` as ``"goal_x"``."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.strip())
    return re.sub(r"[\W_]+", "_", spaced).strip("_").lower()


def _parse(name: str) -> tuple[str | None, str | None]:
    """The canonical name of a column, and the unit that stands in its own: ``"Pos X [mm]"`` is ``x`` in ``mm``."""
    bare, unit = name, None
    if bracket := re.search(r"[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*$", name):
        bare, unit = name[: bracket.start()], bracket[1]
        if not any(unit.lower() in known for known in UNITS.values()):
            bare, unit = (name, None) if unit.isdigit() else (bare, unit)
        else:
            unit = unit.lower()
    tokens = _normal(bare).split("_")
    found = _canonical(tokens)
    if found is None and unit is None and len(tokens) > 1:
        kind = _kind(_canonical(tokens[:-1]) or "")
        if kind and tokens[-1] in UNITS[kind]:
            return _canonical(tokens[:-1]), tokens[-1]
    return found, unit


def _canonical(tokens: Sequence[str]) -> str | None:
    if "_".join(tokens) in KNOWN and tokens[0] not in ("length", "width", "len", "size", "half", "l"):
        part = KNOWN["_".join(tokens)]
        return part
    split = [token for word in tokens for token in re.findall(r"[^\W\d_]+|\d+", word)]
    subject = next((OF_SUBJECT[token] for token in split if token in OF_SUBJECT), None)
    if subject is None:
        rest = [token for token in tokens if token not in FILLING]
        part = KNOWN.get("_".join(rest)) if rest else None
        return None if part in ("length", "width", "half_length", "half_width") else part
    number = next((token for token in split if token.isdigit()), "")
    rest = [token for token in split if token not in OF_SUBJECT and token not in FILLING and not token.isdigit()]
    part = {"width": "width", "w": "width", "length": "length", "l": "length"}.get("_".join(rest)) or KNOWN.get(
        "_".join(rest)
    )
    if part == "heading":
        part = {"box": "angle", "start": "heading"}.get(subject)
    allowed = {"x", "y", "angle", "length", "width", "half_length", "half_width"} if subject == "box" else {"x", "y"}
    if part not in allowed | ({"heading"} if subject == "start" else set()):
        return None
    if subject == "box":
        number = number or "1"
    return f"{subject}{number if subject in ('box', 'human') else ''}_{part}"


def _dates(cells: pd.Series) -> np.ndarray | None:
    """Dates and times of day as seconds; ``None`` for cells that are numbers."""
    if pd.to_numeric(cells, errors="coerce").notna().any():
        return None
    for how in ({"format": "ISO8601"}, {}):
        try:
            dates = pd.to_datetime(cells, utc=True, **how)
            return (dates - dates.min()).dt.total_seconds().to_numpy(float)
        except (ValueError, TypeError):
            continue
    return None


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
    column = named or next((name for name in table.columns if TRACK.fullmatch(_normal(name))), None)
    if column is None or (column in reading.columns.values() and not named):
        ids = None
    elif column not in table.columns:
        raise ValueError(f"{table.path}: there is no column {column} that could be track; {table}.")
    else:
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
    chosen, _ = _choose(table, reading)
    rows = np.flatnonzero(ids == reading.robot)
    columns = {name: cells.iloc[rows].reset_index(drop=True) for name, cells in table.columns.items() if name != column}
    if reading.person is not None:
        other = {name: cells[(ids == reading.person).to_numpy()] for name, cells in table.columns.items()}
        moment = chosen.get("time") or chosen.get("frame")
        if moment is None:
            raise ValueError(f"{table.path}: tracks side by side need a column time or frame; {table}.")
        for part in ("x", "y"):
            place = pd.Series(other[chosen[part]].to_numpy(), index=other[moment].to_numpy())
            columns[f"human_{part}"] = columns[moment].map(place[~place.index.duplicated()])
    left = len(known) - sum(track is not None for track in wanted.values())
    notes = (*table.notes, f"{left} other tracks are left out") if left else table.notes
    return Table(table.path, columns, table.row[rows], table.place, notes)


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
    chosen, _ = _choose(table, reading)
    pose = [chosen[name] for name in ("x", "y", "heading", *(f"q{part}" for part in "xyzw")) if name in chosen]
    filled = {name: cells.mask(cells.astype(str).str.strip().str.lower().isin(BLANK)) for name, cells in
              table.columns.items() if name in pose or re.match("goal|human", _parse(name)[0] or "")}  # fmt: skip
    blank = np.all([filled[name].isna() for name in pose], axis=0) if pose else np.zeros(len(table.row), bool)
    if not blank.any() or blank.all():
        return table
    carried = {name: cells.ffill().bfill() for name, cells in filled.items() if name not in pose}
    columns = {name: cells[~blank].reset_index(drop=True) for name, cells in {**table.columns, **carried}.items()}
    notes = (*table.notes, f"{blank.sum()} rows without a pose left out")
    return Table(table.path, columns, table.row[~blank], table.place, notes)
