"""What columns are called, and in which units they are."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

UNITS = {
    "time": {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3,
             "millis": 1e-3, "milliseconds": 1e-3, "us": 1e-6, "µs": 1e-6, "usec": 1e-6, "micros": 1e-6,
             "microseconds": 1e-6, "ns": 1e-9, "nsec": 1e-9, "nsecs": 1e-9, "nanosec": 1e-9, "nanoseconds": 1e-9,
             "cs": 1e-2, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "length": {"m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "cm": 1e-2, "mm": 1e-3,
               "km": 1e3, "dm": 0.1, "ft": 0.3048, "in": 0.0254},
    "angle": {"rad": 1.0, "radian": 1.0, "radians": 1.0, "deg": np.pi / 180, "degree": np.pi / 180,
              "degrees": np.pi / 180, "°": np.pi / 180, "mrad": 1e-3, "turn": 2 * np.pi, "turns": 2 * np.pi,
              "rev": 2 * np.pi, "pi": np.pi, "gon": np.pi / 200, "cdeg": np.pi / 18000},
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

SIDES = ("length", "width", "half_length", "half_width")
KINDS = {"time": "time", "stamp_sec": "time", **dict.fromkeys(("x", "y", *SIDES), "length"), "heading": "angle",
         "angle": "angle", "v": "speed", "omega": "turn", **{f"q{part}": "" for part in "xyzw"}}  # fmt: skip
SCENE = ("goal_x", "goal_y", "human_x", "human_y", "start_x", "start_y", "start_heading")


def kind(name: str) -> str | None:
    """What is measured in a column; ``""`` for pure numbers, ``None`` for unknown names.

    >>> kind("x"), kind("box2_angle"), kind("goal_heading")
    ('length', 'angle', None)
    """
    if name in SCENE or re.fullmatch(rf"box\d+_({'|'.join(SIDES)}|x|y|angle)", name):
        return KINDS[name.partition("_")[2]]
    return None if name in (*SIDES, "angle") else KINDS.get(name)


def plain(name: str) -> str:
    """``"goalX"`` and ``"Goal x"`` as ``"goal_x"``."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.strip())
    return re.sub(r"[\W_]+", "_", spaced).strip("_").lower()


def parse(name: str) -> tuple[str | None, str | None]:
    """The canonical name of a column, if it has one, and the unit that stands in its own.

    >>> parse("Pos X [mm]"), parse("yaw_deg"), parse("ped2_y"), parse("battery")
    (('x', 'mm'), ('heading', 'deg'), ('human2_y', None), (None, None))
    """
    bare, unit = name, None
    if bracket := re.search(r"[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*$", name):
        bare, unit = name[: bracket.start()], bracket[1]
        if any(unit.lower() in known for known in UNITS.values()):
            unit = unit.lower()
        elif unit.isdigit():
            bare, unit = name, None
    tokens = plain(bare).split("_")
    found = _canonical(tokens)
    if found is None and unit is None and len(tokens) > 1:
        of = kind(_canonical(tokens[:-1]) or "")
        if of and tokens[-1] in UNITS[of]:
            return _canonical(tokens[:-1]), tokens[-1]
    return found, unit


def _canonical(tokens: Sequence[str]) -> str | None:
    whole = KNOWN.get("_".join(tokens))
    if whole is not None and whole not in SIDES:
        return whole
    split = [token for word in tokens for token in re.findall(r"[^\W\d_]+|\d+", word)]
    subject = next((OF_SUBJECT[token] for token in split if token in OF_SUBJECT), None)
    rest = [token for token in (split if subject else tokens) if token not in OF_SUBJECT and token not in FILLING]
    if subject is None:
        part = KNOWN.get("_".join(rest))
        return None if part in SIDES else part
    number = next((token for token in split if token.isdigit()), "")
    word = "_".join(token for token in rest if not token.isdigit())
    part = KNOWN.get(word)
    if subject == "box":
        part, number = "width" if word == "w" else "angle" if part == "heading" else part, number or "1"
    name = f"{subject}{number if subject in ('box', 'human') else ''}_{part}"
    return name if kind(re.sub(r"^human\d+", "human", name)) is not None else None
