"""Bags as robots record them: ten minutes between two places, past somebody who stands there."""

import itertools
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from support import BRIEF

pytest.importorskip("rosbags")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from morlnav.commands import record
from morlnav.navigation.demonstrations import Reading, import_demonstrations, load_demonstrations, read_trajectories
from morlnav.navigation.world import Lidar, TensorWorld

STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
HUMAN, PLACES, RATE = (3.0, 0.2), ((6.0, 0.0), (0.0, 0.0)), 50
START = 1_730_000_000_000_000_000


def patrol(seconds=600.0, step=1 / RATE):
    """Poses ``[N, 3]`` and actions ``[N, 2]`` of driving to and fro, and when which place becomes the goal."""
    x, y, heading, v, w = 0.0, 0.0, 0.0, 0.0, 0.0
    poses, actions, goals, turning, since = [], [], [(0, 0)], True, 0
    for i in range(round(seconds * RATE)):
        goal = PLACES[goals[-1][1]]
        aside = 1.2 * np.exp(-((max(0.0, abs(x - HUMAN[0]) - 0.5) / 0.9) ** 2))
        bearing = np.arctan2(aside - y, np.copysign(0.8, goal[0] - x)) - heading
        bearing = (bearing + np.pi) % (2 * np.pi) - np.pi
        turning = abs(bearing) > (0.2 if turning else 1.2)
        v += np.clip((0.0 if turning else 0.4) - v, -step, step)  # 1 m/s² and 1 rad/s² at most
        w += np.clip(np.clip(1.5 * bearing, -0.8, 0.8) - w, -step, step)
        poses.append((x, y, heading))
        actions.append((v, w))
        course, heading = heading + w * step / 2, heading + w * step
        x, y = x + v * step * np.cos(course), y + v * step * np.sin(course)
        since += 1
        if np.hypot(x - goal[0], y - goal[1]) < 0.3 and since > RATE:
            goals.append((i + 1, 1 - goals[-1][1]))
            since = 0
    return np.array(poses), np.array(actions), goals


@pytest.fixture(scope="module")
def driven():
    return patrol()


def write_bag(
    path, driven, version=2, topics=("odom", "goal", "scan"), seconds=600.0, human_at=HUMAN, change=None, **how
):
    """A bag with 50 Hz odometry or tf, 10 Hz scans and goals; ``change(topic, number, message)`` may spoil messages."""
    store, (poses, _, goals) = STORES[version], driven
    types = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
    types["Time"] = store.types["builtin_interfaces/msg/Time"]
    numbered = {"seq": 0} if version == 1 else {}

    def header(stamp, frame):
        return types["Header"](
            **numbered, stamp=types["Time"](sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id=frame
        )

    def pose_of(x, y, heading):
        turn = types["Quaternion"](x=0.0, y=0.0, z=np.sin(heading / 2), w=np.cos(heading / 2))
        return types["Pose"](position=types["Point"](x=x, y=y, z=0.0), orientation=turn)

    def transform(stamp, parent, child, x, y, heading):
        pose = pose_of(x, y, heading)
        place = types["Vector3"](x=x, y=y, z=0.0)
        moved = types["Transform"](translation=place, rotation=pose.orientation)
        return types["TransformStamped"](header=header(stamp, parent), child_frame_id=child, transform=moved)

    still, none = types["Vector3"](x=0.0, y=0.0, z=0.0), np.zeros(36)
    twist = types["TwistWithCovariance"](twist=types["Twist"](linear=still, angular=still), covariance=none)
    count, lidar, world = round(seconds * RATE), Lidar(rays=180, sectors=1, max_range=8.0), TensorWorld()
    writer = Writer1(path) if version == 1 else Writer2(path, version=9, **how)
    with writer:

        def channel(topic, kind):
            connection = writer.add_connection(topic, kind, typestore=store)
            encode, number = store.serialize_ros1 if version == 1 else store.serialize_cdr, itertools.count()

            def send(stamp, message):
                if change is not None:
                    message = change(topic, next(number), message)
                if message is not None:
                    writer.write(connection, stamp, encode(message, kind))

            return send

        kinds = {"odom": ("/odom", "nav_msgs/msg/Odometry"), "tf": ("/tf", "tf2_msgs/msg/TFMessage"),
                 "scan": ("/scan", "sensor_msgs/msg/LaserScan"),
                 "goal": ("/goal_pose", "geometry_msgs/msg/PoseStamped"),
                 "person": ("/person", "geometry_msgs/msg/PointStamped"),
                 "people": ("/people", "geometry_msgs/msg/PoseArray")}  # fmt: skip
        send = {name: channel(*kinds[name]) for name in topics}
        starts, every = dict(goals), RATE // 10
        here, box = torch.tensor(poses[:count:every]).float(), torch.tensor([[3.0, 4.0, 6.0, 0.1, 0.0]])
        human = torch.tensor([human_at]).expand(len(here), 2)
        scans = lidar.cast(here, human, box.expand(len(here), 1, 5), world.human_radius).numpy()
        for i in range(count):
            stamp, pose = START + i * 10**9 // RATE, poses[i].tolist()
            if "goal" in send and i in starts:
                goal = pose_of(*PLACES[starts[i]], 0.0)
                send["goal"](stamp, types["PoseStamped"](header=header(stamp, "odom"), pose=goal))
            if "odom" in send:
                where = types["PoseWithCovariance"](pose=pose_of(*pose), covariance=none)
                parts = {"child_frame_id": "base_link", "pose": where, "twist": twist}
                send["odom"](stamp, types["Odometry"](header=header(stamp, "odom"), **parts))
            if "tf" in send:
                moves = [transform(stamp, "odom", "base_link", *pose)]
                if i % RATE == 0:
                    moves.insert(0, transform(stamp, "map", "odom", 10.0, 5.0, 0.5))
                send["tf"](stamp, types["TFMessage"](transforms=moves))
            if "person" in send and i % 10 == 0:
                there = types["Point"](x=human_at[0] + 0.01 * (-1) ** i, y=human_at[1], z=0.0)
                send["person"](stamp, types["PointStamped"](header=header(stamp, "odom"), point=there))
            if "people" in send and i % 10 == 0:
                there = [pose_of(*human_at, 0.0)] * (i % 20 == 0)  # nobody is seen at times
                send["people"](stamp, types["PoseArray"](header=header(stamp, "odom"), poses=there))
            if "scan" in send and i % every == 0:
                ranges = scans[i // every]
                message = {"angle_min": -np.pi, "angle_max": np.pi, "angle_increment": 2 * np.pi / 180}
                message |= {"range_min": 0.1, "range_max": 8.0, "time_increment": 0.0, "scan_time": 0.1}
                scan = types["LaserScan"](header(stamp, "base_link"), ranges=ranges, intensities=ranges[:0], **message)
                send["scan"](stamp, scan)


def test_a_bag_becomes_a_policy_by_the_commands_of_the_page(driven, tmp_path, train_command, monkeypatch, capsys):
    write_bag(tmp_path / "hall_bag", driven)
    page = (Path(__file__).parents[3] / "docs" / "own-demonstrations.md").read_text()
    block = page.partition("## From a bag to a policy")[2].partition("```bash\n")[2].partition("```")[0]
    lines = [line for line in block.replace("\\\n", "").splitlines() if "morlnav" in line]
    commands = [
        shlex.split(line.partition("morlnav-")[1] + line.partition("morlnav-")[2], comments=True) for line in lines
    ]
    assert [words[0] for words in commands] == ["morlnav-record", "morlnav-train"]
    monkeypatch.setattr(sys, "argv", commands[0])
    record.main()
    told = capsys.readouterr().out
    assert "hall_bag: 30000 rows, " in told
    assert "at 50 Hz" in told
    assert "the scans show the human at (3.00, 0.20)" in told
    assert "topics /goal_pose, /odom, /scan are read, none ignored" in told
    data, (poses, actions, goals) = load_demonstrations("recordings/hall"), driven
    episodes = data["episode"].unique().tolist()
    assert len(episodes) >= 25
    for number in episodes[:-1]:
        drive, first = data[data["episode"] == number], goals[number][0]
        sample = first + 10 * drive["step"].numpy()
        off = drive["pose"].numpy() - poses[sample]
        assert np.hypot(off[:, 0], off[:, 1]).max() < 0.01
        truth = np.stack([actions[i : i + 10].mean(0) for i in sample[:-1]])
        apart = np.abs(drive["action"][:-1].numpy() - truth)
        assert apart[:, 0].max() < 0.02
        assert apart[:, 1].max() < 0.05
    train_command(*commands[1][1:], *BRIEF, "trainer.total_frames=128", "threads=1", "hydra.run.dir=run")
    assert (tmp_path / "run" / "policy.pt").is_file()
    assert (tmp_path / "run" / "reward.pt").is_file()


@pytest.mark.parametrize("how", ["ros1", "mcap", "tf"])
def test_other_bags_tell_the_same(how, driven, tmp_path):
    path = tmp_path / {"ros1": "drive.bag", "mcap": "drive", "tf": "drive"}[how]
    options = {"storage_plugin": StoragePlugin.MCAP} if how == "mcap" else {}
    topics = ("tf", "scan") if how == "tf" else ("odom", "scan")
    write_bag(path, driven, 1 if how == "ros1" else 2, topics, 14.0, **options)
    if how == "mcap":
        (path,) = path.glob("*.mcap")
    file = read_trajectories(path, Reading(goal="end"))
    cos, sin = np.cos(0.5), np.sin(0.5)
    turn, shift = (np.array([[cos, -sin], [sin, cos]]), (10, 5)) if how == "tf" else (np.eye(2), (0, 0))
    assert np.allclose(file.samples[:, :2], driven[0][:700, :2] @ turn.T + shift, atol=1e-6)
    assert np.allclose(file.scene["human"][0], turn @ HUMAN + shift, atol=0.02)


@pytest.mark.parametrize("topic", ["person", "people"])
def test_people_may_have_a_topic_of_their_own(topic, driven, tmp_path):
    write_bag(tmp_path / "bag", driven, topics=("odom", "goal", topic), seconds=20.0)
    file = read_trajectories(tmp_path / "bag")
    assert np.allclose(file.scene["human"], HUMAN, atol=0.011)
    assert file.rows(0)[0] == 0


def test_what_a_bag_does_not_tell_is_asked_for(driven, tmp_path):
    write_bag(tmp_path / "bare", driven, topics=("odom",), seconds=14.0)
    for reading, words in [
        (Reading(), "expected a column goal_x"),
        (Reading(goal="end"), "expected a column human_x"),
        (Reading(goal="end", human="scan"), r"expected scans to find the human in; the topics are /odom \(Odometry\)"),
        (Reading(columns={"pose": "/amcl"}), "there is no topic /amcl with messages that could be pose"),
    ]:
        with pytest.raises(ValueError, match=words):
            read_trajectories(tmp_path / "bare", reading)
    write_bag(tmp_path / "far", driven, topics=("odom", "scan"), seconds=14.0, human_at=(30.0, 30.0))
    with pytest.raises(ValueError, match=r"show nothing of a person's size; say where the human stands with --human"):
        read_trajectories(tmp_path / "far", Reading(goal="end"))
    write_bag(tmp_path / "tf", driven, topics=("tf", "goal"), seconds=2.0)
    with pytest.raises(ValueError, match=r"goal of /goal_pose is told in the frame 'odom', and the poses in 'map'"):
        read_trajectories(tmp_path / "tf")
    (tmp_path / "bad.bag").write_bytes(b"#ROSBAG V2.0\nnothing")
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}")
    shutil.copytree(tmp_path / "bare", tmp_path / "garbled")
    (tmp_path / "garbled" / "metadata.yaml").write_bytes(b"\xff\xfe: [")
    shutil.copytree(tmp_path / "bare", tmp_path / "loose")
    (tmp_path / "loose" / "metadata.yaml").unlink()
    with pytest.raises(ValueError, match=r"a ROS 2 bag without its metadata.yaml; give the .db3"):
        read_trajectories(tmp_path / "loose")
    loose = read_trajectories(next((tmp_path / "loose").glob("*.db3")), Reading(goal="end", human=HUMAN))
    assert len(loose.time) == 700
    with pytest.raises(ValueError, match=r"--human: human of episode 0 lies .* is it in another frame than the robot"):
        read_trajectories(tmp_path / "bare", Reading(goal="end", human=(300.0, 0.2)))
    for name in ("bad.bag", "torn", "garbled"):
        with pytest.raises(ValueError, match=name) as caught:
            import_demonstrations(tmp_path / name)
        assert "\n" not in str(caught.value)


def spoilt(name, numbers=None, **parts):
    """Changes entries of the messages of a topic, as ``pose__pose__position__x``."""

    def change(topic, number, message):
        if topic != name or (numbers is not None and number not in numbers):
            return message
        for path, value in parts.items():
            *way, last = path.split("__")
            entry = message
            for step in way:
                entry = getattr(entry, step)
            object.__setattr__(entry, last, value)
        return message

    return change


def several(topic, number, message):
    if topic == "/people":
        message.poses.append(message.poses[0] if message.poses else None)
        return message if message.poses[0] is not None else None
    return message


PLACE, TURN = "pose__pose__position__", "pose__pose__orientation__"
ZERO = {f"{TURN}{part}": 0.0 for part in "xyzw"}
SPOILT = {
    "no number": (spoilt("/odom", [30], **{f"{PLACE}x": np.nan}), "message 30 of /odom, column x: expected a number"),
    "no end": (
        spoilt("/odom", [30], **{f"{PLACE}y": np.inf}),
        "message 30 of /odom, column y: expected a finite",
    ),
    "a quaternion of zeros": (spoilt("/odom", [60], **ZERO), "message 60 of /odom: expected a quaternion of length 1"),
    "a quaternion of no numbers": (
        spoilt("/odom", [60], **{f"{TURN}z": np.nan}),
        "message 60 of /odom: expected a",
    ),
    "a camera's frame": (
        spoilt("/odom", **{f"{TURN}x": 0.5, f"{TURN}y": -0.5, f"{TURN}z": 0.5, f"{TURN}w": 0.5}),
        "would lean by",
    ),
    "two frames": (spoilt("/odom", range(99), header__frame_id="map"), "/odom tells poses in the frames map, odom"),
    "a frame without a name": (spoilt("/odom", header__frame_id=""), "told in the frame 'odom', and the poses in ''"),
    "a goal of no numbers": (spoilt("/goal_pose", pose__position__x=np.nan), "column goal_x: expected a number"),
    "two clocks": (
        spoilt("/goal_pose", header__stamp__sec=1_740_000_000),
        "s after the last pose; are their times of two clocks?",
    ),
    "a clock that stands": (spoilt("/odom", header__stamp__sec=1, header__stamp__nanosec=0), "of two clocks?"),
    "two people": (several, "/people tells 2 places at once; say which with --human X Y"),
}


@pytest.mark.parametrize("name", SPOILT)
def test_what_is_wrong_in_a_message_is_named(name, driven, tmp_path):
    change, words = SPOILT[name]
    topics = ("odom", "goal", "people" if name == "two people" else "person")
    write_bag(tmp_path / "bag", driven, topics=topics, seconds=14.0, change=change)
    with pytest.raises(ValueError, match="bag") as caught:
        import_demonstrations(tmp_path / "bag")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_clocks_that_are_not_set_do_not_matter(driven, tmp_path):
    write_bag(tmp_path / "bag", driven, topics=("odom", "person"), seconds=14.0,
              change=spoilt("/odom", header__stamp__sec=0, header__stamp__nanosec=0))  # fmt: skip
    assert np.allclose(np.diff(read_trajectories(tmp_path / "bag", Reading(goal="end")).time), 1 / RATE)


DAMAGES = {
    "cut in half": lambda data: data[: len(data) // 2],
    "cut at the end": lambda data: data[: int(0.9 * len(data))],
    "emptied": lambda data: b"",
    "garbage": lambda data: np.random.default_rng(0).bytes(len(data)),
    "zeros": lambda data: data[: len(data) // 3] + bytes(len(data) // 3) + data[2 * (len(data) // 3) :],
    "deleted": None,
}


@pytest.mark.parametrize("plugin", StoragePlugin)
@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_noticed(plugin, damage, driven, tmp_path):
    write_bag(tmp_path / "bag", driven, topics=("odom", "person"), seconds=14.0, storage_plugin=plugin)
    for file in [*(tmp_path / "bag").iterdir()]:
        data = file.read_bytes()
        file.unlink() if DAMAGES[damage] is None else file.write_bytes(DAMAGES[damage](data))
        with pytest.raises((ValueError, FileNotFoundError), match="bag") as caught:
            import_demonstrations(tmp_path / "bag", reading=Reading(goal="end"))
        assert "\n" not in str(caught.value)
        file.write_bytes(data)
    assert len(import_demonstrations(tmp_path / "bag", reading=Reading(goal="end"))) > 50
