"""ROS bags, of ROS 1 and ROS 2, as tables: where the robot was, where it went, and who stood in the way."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.columns import TOPICS, Reading
from morlnav.navigation.demonstrations.samples import yaw_of
from morlnav.navigation.demonstrations.scans import things
from morlnav.navigation.demonstrations.table import Table

POSES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped")
PLACES = (*POSES[1:], "geometry_msgs/msg/PointStamped", "geometry_msgs/msg/PoseArray")
TF, SCAN = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/LaserScan"
BASES = ("base_footprint", "base_link")
MOST_SCANS = 600


def read_bag(path: Path, reading: Reading) -> tuple[Table, Reading]:
    """Read a ROS 1 bag (``.bag``) or a ROS 2 bag (a folder, or its ``.mcap``); nothing of ROS needs to be installed.

    Poses come from odometry, from a topic of poses, or from ``/tf``; every message on a topic of goals begins an
    episode; the human comes from a topic of poses or points, or from the scans. Topics are chosen by
    ``Reading(columns={"pose": "/odom", "goal": ..., "human": ..., "scan": ...})`` where several could be meant.

    Args:
        path: of the bag.
        reading: what is known beforehand.

    Returns:
        A table with a row per pose, and ``reading`` with what the bag tells.

    Raises:
        ValueError: in one sentence, without the package ``rosbags``, for a damaged bag, and listing the topics if none
            or several could be meant.

    Examples:
        >>> read_bag(Path("drive_bag"), Reading(goal="end"))  # doctest: +SKIP
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise ValueError(f"{path} is a ROS bag; install what reads it with: pip install 'morlnav[ros]'") from error
    if path.suffix == ".db3" and (path.parent / "metadata.yaml").is_file():
        path = path.parent
    if not path.exists():
        raise FileNotFoundError(f"There is no file {path}.")
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            return _Bag(path, reader, reading).table()
    except AnyReaderError as error:
        raise ValueError(f"{path} is no ROS bag that can be read: {str(error).splitlines()[0]}") from error
    except Exception as error:  # of the many kinds that damaged storage raises
        if isinstance(error, ValueError | OSError) and not isinstance(error, UnicodeError):
            raise
        raise ValueError(f"{path} is damaged: {type(error).__name__}: {error}".splitlines()[0]) from error


class _Bag:
    """One bag while it is open."""

    def __init__(self, path: Path, reader: Any, reading: Reading) -> None:
        self.path, self.reader, self.reading = path, reader, reading
        self.notes: list[str] = []
        self.used: set[str] = set()
        wrong = [f"columns {name}" for name in reading.columns if name not in TOPICS]
        wrong += [name for name in ("separator", "decimal", "names") if getattr(reading, name) is not None]
        if wrong:
            raise ValueError(f"{path} is a bag, of which {wrong[0]} says nothing; its parts are {', '.join(TOPICS)}.")

    def table(self) -> tuple[Table, Reading]:
        """All of it."""
        time, pose, frame, topic = self.poses()
        columns = {"time": time - time[0], **dict(zip(("x", "y", "heading"), pose.T, strict=True))}
        row = np.arange(len(time))
        goal = self.places("goal", "goal", frame) if self.reading.goal is None else None
        human = self.places("human", "human person people ped", frame) if self.reading.human is None else None
        if goal is not None:
            number, place = _changes(*goal)
            which = np.searchsorted(number, time, side="right") - 1
            keep = which >= 0
            if not keep.any():
                raise self.refuse(
                    f"the first goal comes {number[0] - time[-1]:.4g} s after the last pose; are their times of two "
                    f"clocks? Then give --goal X Y or --goal end"
                )
            if (~keep).any():
                self.notes.append(f"{(~keep).sum()} poses before the first goal left out")
            columns |= {"episode": which, "goal_x": place[which, 0], "goal_y": place[which, 1]}
            columns = {name: values[keep] for name, values in columns.items()}
            row = row[keep]
        if human is not None:
            seen = human[1][np.searchsorted(human[0], time).clip(max=len(human[0]) - 1)][row]
            columns |= {"human_x": seen[:, 0], "human_y": seen[:, 1]}
        reading = replace(self.reading, columns={})
        if human is None and (self.reading.human == "scan" or (self.reading.human is None and self.topics(SCAN))):
            reading = replace(reading, human=self.person(time, pose))
        left = sorted({connection.topic for connection in self.reader.connections} - self.used)
        self.notes.append(f"topics {', '.join(sorted(self.used))} are read, {', '.join(left) or 'none'} ignored")
        series = {name: pd.Series(values) for name, values in columns.items()}
        return Table(self.path, series, row, f"message {{}} of {topic}", tuple(self.notes)), reading

    def topics(self, *kinds: str) -> list[str]:
        """Topics of messages of some kinds that are not empty, in the order of the kinds."""
        found = {c.topic: c.msgtype for c in self.reader.connections if c.msgcount}
        return sorted((topic for topic, kind in found.items() if kind in kinds), key=lambda t: kinds.index(found[t]))

    def kind(self, topic: str) -> str:
        """What a topic's messages are."""
        return next(c.msgtype for c in self.reader.connections if c.topic == topic)

    def refuse(self, what: str) -> ValueError:
        """What to say where topics do not tell."""
        listed = ", ".join(f"{c.topic} ({c.msgtype.rpartition('/')[2]})" for c in self.reader.connections)
        return ValueError(f"{self.path}: {what}; the topics are {listed or 'none'}.")

    def messages(self, topic: str, every: int = 1) -> Iterator[tuple[float, Any]]:
        """Messages of a topic and their times in seconds: of their headers, or of the recording where these are 0."""
        self.used.add(topic)
        connections, i = [c for c in self.reader.connections if c.topic == topic], -1
        for i, (connection, stamp, data) in enumerate(self.reader.messages(connections=connections)):
            if i % every == 0:
                message = self.reader.deserialize(data, connection.msgtype)
                header = getattr(message, "header", None)
                told = header.stamp.sec * 10**9 + header.stamp.nanosec if header is not None else 0
                yield 1e-9 * ((told or stamp) - self.reader.start_time), message
        if (count := sum(connection.msgcount for connection in connections)) != i + 1:
            raise ValueError(f"{self.path} is damaged: of {count} messages of {topic} it holds {i + 1}.")

    def chosen(self, part: str, topics: Sequence[str], needed: str = "") -> str | None:
        """The topic that is named for a part, or the only one there is."""
        named = self.reading.columns.get(part)
        if named is not None:
            if named not in {c.topic for c in self.reader.connections if c.msgcount}:
                raise self.refuse(f"there is no topic {named} with messages that could be {part}")
            return named
        if len(topics) > 1:
            raise self.refuse(f"{part} could be {' or '.join(topics)}; choose with --columns {part}=TOPIC")
        if needed and not topics:
            raise self.refuse(needed)
        return topics[0] if topics else None

    def poses(self) -> tuple[np.ndarray, np.ndarray, str, str]:
        """Times ``[N]``, poses ``[N, 3]``, their frame and topic."""
        others = "goal human person people ped"
        kinds = [[topic for topic in self.topics(kind) if not _about(topic, others)] for kind in POSES]
        moves = [topic for topic in self.topics(TF) if "static" not in topic]
        best = next((topics for topics in (*kinds, moves) if topics), [])
        topic = self.chosen("pose", best, "expected odometry, poses or tf")
        if self.kind(topic) == TF:
            return *self.from_tf(topic), topic
        if self.kind(topic) not in POSES:
            raise self.refuse(f"{topic} tells no poses")
        rows, frames = [], {}
        for time, message in self.messages(topic):
            pose, q = _pose_of(message), _pose_of(message).orientation
            frames[message.header.frame_id] = None
            rows.append((time, pose.position.x, pose.position.y, q.x, q.y, q.z, q.w))
        if len(frames) > 1:
            raise self.refuse(f"{topic} tells poses in the frames {', '.join(frames)}; expected one")
        values = np.array(rows)
        heading = yaw_of(values[:, 3:], lambda row: f"{self.path}, message {row} of {topic}")
        return values[:, 0], np.column_stack([values[:, 1:3], heading]), next(iter(frames)), topic

    def from_tf(self, topic: str) -> tuple[np.ndarray, np.ndarray, str]:
        """Poses of the base, by way of all transforms between it and ``map``, or whatever frame is the first."""
        moves = self.transforms(topic)
        base = next((name for name in BASES if name in moves), None)
        if base is None:
            raise self.refuse(f"expected a transform to {' or '.join(BASES)}, got those to {', '.join(moves)}")
        parent, time, pose = moves[base]
        while parent in moves:
            above, stamps, poses = moves[parent]
            pose = _compose(poses[(np.searchsorted(stamps, time, side="right") - 1).clip(min=0)], pose)
            parent = above
        return time, pose, parent

    def transforms(self, *topics: str) -> dict[str, tuple[str, np.ndarray, np.ndarray]]:
        """By child frame: its parent, times ``[N]`` and poses in it ``[N, 3]``."""
        rows: dict[str, list] = defaultdict(list)
        parents = {}
        for topic in topics or self.topics(TF):
            for _, message in self.messages(topic):
                for each in message.transforms:
                    place, child = each.transform.translation, each.child_frame_id.lstrip("/")
                    stamp = 1e-9 * (each.header.stamp.sec * 10**9 + each.header.stamp.nanosec - self.reader.start_time)
                    rows[child].append((stamp, place.x, place.y, _yaw(each.transform.rotation)))
                    parents[child] = each.header.frame_id.lstrip("/")
        tables = {child: np.array(sorted(values)) for child, values in rows.items()}
        return {child: (parents[child], table[:, 0], table[:, 1:]) for child, table in tables.items()}

    def places(self, part: str, words: str, frame: str) -> tuple[np.ndarray, np.ndarray] | None:
        """Times ``[N]`` and places ``[N, 2]`` of a topic of goals or humans; ``None`` without one."""
        topic = self.chosen(part, [topic for topic in self.topics(*PLACES) if _about(topic, words)])
        if topic is None:
            return None
        rows = []
        for time, message in self.messages(topic):
            told = message.header.frame_id
            if told.lstrip("/") != frame.lstrip("/"):
                raise self.refuse(
                    f"the {part} of {topic} is told in the frame {told!r}, and the poses in {frame!r}; choose poses in "
                    f"the same one with --columns pose=TOPIC, such as /tf, or give --{part} X Y"
                )
            places = _places_of(message)
            if len(places) > 1:
                raise self.refuse(f"{topic} tells {len(places)} places at once; say which with --{part} X Y")
            rows += [(time, place.x, place.y) for place in places]
        values = np.array(rows).reshape(-1, 3)
        return (values[:, 0], values[:, 1:]) if rows else None

    def person(self, time: np.ndarray, pose: np.ndarray) -> tuple[float, float]:
        """Where the scans see the one thing of a person's size."""
        topic = self.chosen("scan", self.topics(SCAN), "expected scans to find the human in")
        points = self.points(topic, time, pose)
        people = list(things(points))
        round_ones = [place for place, is_round in people if is_round] or [place for place, _ in people]
        if len(round_ones) != 1:
            seen = ", ".join(f"({x:.2f}, {y:.2f})" for x, y in round_ones[:8])
            raise self.refuse(
                f"the scans of {topic} show {len(round_ones) or 'nothing'}{' things' * bool(round_ones)} of a person's "
                f"size{f', at {seen}' if seen else ''}; say where the human stands with --human X Y"
            )
        x, y = round_ones[0]
        self.notes.append(f"the scans show the human at ({x:.2f}, {y:.2f})")
        return float(x), float(y)

    def points(self, topic: str, time: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Returns of the scans in the frame of the poses, ``[N, 3]``: x, y and the number of the scan."""
        count = sum(c.msgcount for c in self.reader.connections if c.topic == topic)
        mounts, parts = self.transforms(), []
        heading = np.unwrap(pose[:, 2])
        for number, (stamp, scan) in enumerate(self.messages(topic, every=1 + count // MOST_SCANS)):
            here = np.array([np.interp(stamp, time, column) for column in (pose[:, 0], pose[:, 1], heading)])
            parent, _, mount = mounts.get(scan.header.frame_id.lstrip("/"), ("", None, np.zeros((1, 3))))
            here = _compose(here[None], mount[:1]) if parent in BASES else here[None]
            ranges = np.asarray(scan.ranges, float)
            angle = here[0, 2] + scan.angle_min + scan.angle_increment * np.arange(len(ranges))
            seen = np.isfinite(ranges) & (ranges > max(scan.range_min, 0.05)) & (ranges < 0.99 * scan.range_max)
            reach = ranges[seen, None] * np.stack([np.cos(angle[seen]), np.sin(angle[seen])], 1)
            parts.append(np.column_stack([here[0, :2] + reach, np.full(seen.sum(), number)]))
        return np.concatenate(parts) if parts else np.zeros((0, 3))


def _about(topic: str, words: str) -> bool:
    return any(word in topic.lower() for word in words.split())


def _pose_of(message: Any) -> Any:
    return message.pose.pose if hasattr(message.pose, "pose") else message.pose


def _places_of(message: Any) -> list[Any]:
    """Points in a message of any of the kinds :data:`PLACES`."""
    if hasattr(message, "poses"):
        return [pose.position for pose in message.poses]
    return [message.point if hasattr(message, "point") else _pose_of(message).position]


def _yaw(q: Any) -> float:
    return float(np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z)))


def _compose(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Poses ``[N, 3]`` told in frames whose own poses are ``outer`` ``[N, 3]``."""
    cos, sin = np.cos(outer[:, 2]), np.sin(outer[:, 2])
    x = outer[:, 0] + cos * inner[:, 0] - sin * inner[:, 1]
    y = outer[:, 1] + sin * inner[:, 0] + cos * inner[:, 1]
    return np.stack([x, y, outer[:, 2] + inner[:, 2]], 1)


def _changes(time: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and places ``[K]`` at which a place is another than before."""
    new = np.concatenate([[True], (np.abs(np.diff(place, axis=0)) > 1e-3).any(1)])
    return time[new], place[new]
