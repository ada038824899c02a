"""The ROS 2 node drives by messages as the simulator does by its world, and stops for whatever is not right."""

import dataclasses
import math
import runpy
from pathlib import Path

import pytest
import torch

import morlnav
from morlnav.navigation.evaluation import evaluation_scenes
from morlnav.navigation.world import TensorWorld

ROSBAGS = pytest.importorskip("rosbags.typesys")
STORE = ROSBAGS.get_typestore(ROSBAGS.Stores.ROS2_HUMBLE)
ROOT = Path(__file__).parents[1]
Driver = runpy.run_path(str(ROOT / "examples" / "ros2_node.py"))["Driver"]
DISTANCE = [0.0, 1.0, 0.0]


def message(kind, **content):
    """A ROS message with this content; what is read beyond it would be ``None``."""
    cls = next(STORE.types[f"{package}/msg/{kind}"] for package in PACKAGES if f"{package}/msg/{kind}" in STORE.types)
    return cls(**{field.name: content.pop(field.name, None) for field in dataclasses.fields(cls)}, **content)


PACKAGES = ("std_msgs", "geometry_msgs", "sensor_msgs", "nav_msgs", "builtin_interfaces")


def header(time, frame="odom"):
    stamp = message("Time", sec=int(time), nanosec=round(1e9 * (time % 1)))
    return message("Header", stamp=stamp, frame_id=frame)


def pose(x, y, heading=0.0):
    turned = message("Quaternion", x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2))
    return message("Pose", position=message("Point", x=x, y=y, z=0.0), orientation=turned)


def messages(world, time=0.0):
    """What the first robot of a world would hear."""
    scene, place = world.scene, world.pose[0].tolist()
    ranges = world.lidar.cast(world.pose, scene.human, scene.boxes, world.human_radius)[0]
    ranges[ranges >= world.lidar.max_range] = math.inf
    turn = {"angle_min": -math.pi, "angle_increment": math.pi / 360, "range_min": 0.05, "range_max": 12.0}
    people = [pose(*scene.human[0].tolist()), pose(math.nan, 0.0)]
    return {
        "scan": message("LaserScan", header=header(time, "laser"), ranges=ranges.numpy(), **turn),
        "odometry": message("Odometry", header=header(time), pose=message("PoseWithCovariance", pose=pose(*place))),
        "people": message("PoseArray", header=header(time), poses=people),
        "goal": message("PoseStamped", header=header(time), pose=pose(*scene.goal[0].tolist())),
    }


@pytest.fixture(scope="module")
def policy():
    return morlnav.load(ROOT / "results" / "default")


@pytest.fixture
def world():
    world = TensorWorld()
    world.reset(evaluation_scenes(1))
    return world


@pytest.fixture
def driver(policy, world):
    driver = Driver(policy)
    driver.messages |= messages(world, 100.0)
    return driver


def test_it_drives_to_the_goal_as_the_policy_does(policy, world):
    driver, goal = Driver(policy), messages(world)["goal"]
    for step in range(250):
        driver.messages |= messages(world, 0.2 * step) | {"goal": goal}  # which does not age
        v, omega, reason = driver.command(DISTANCE, 0.2 * step + 0.1)
        assert reason == ""
        expected = policy(world.observe(), torch.tensor(DISTANCE))[0]
        torch.testing.assert_close(torch.tensor([v, omega]), expected, rtol=0, atol=2e-3)
        contact = world.step(torch.tensor([[v, omega]]))
        assert not contact.human
        assert not contact.box
        if contact.goal:
            driver.messages |= messages(world, 0.2 * step)
            assert driver.command(DISTANCE, 0.2 * step) == (0, 0, "The goal is reached.")
            return
    pytest.fail("It did not arrive.")


@pytest.mark.parametrize("name", ["scan", "odometry", "people"])
def test_the_watchdog_stops_it(driver, world, name):
    driver.messages |= {key: value for key, value in messages(world, 100.6).items() if key != name}
    assert driver.command(DISTANCE, 100.4)[0] > 0
    assert driver.command(DISTANCE, 101.0) == (
        *(0, 0),
        f"The last message of {name} is 1.00 s old, at most 0.5 s are allowed.",
    )
    del driver.messages[name]
    assert driver.command(DISTANCE, 101.0) == (0, 0, f"There is no message of {name} yet.")


def test_it_waits_for_a_goal(driver):
    del driver.messages["goal"]
    assert driver.command(DISTANCE, 100.0) == (0, 0, "There is no goal yet.")


def test_messages_from_the_future_stop_it(driver):
    assert "scan is -1.00 s old" in driver.command(DISTANCE, 99.0)[2]
    assert "scan is nan s old" in driver.command(DISTANCE, math.nan)[2]


@pytest.mark.parametrize("name", ["goal", "people"])
def test_another_frame_stops_it(driver, name):
    driver.messages[name].header.frame_id = "map"
    *speeds, reason = driver.command(DISTANCE, 100.0)
    assert (speeds, reason) == ([0, 0], f"The frame of {name} must be that of the odometry, odom, got map.")


@pytest.mark.parametrize(
    ("preference", "sentence"),
    [([5.0, -3.0, 9.0], "add up to 1, got"), ([math.nan, 0.5, 0.5], "add up to 1"), ([1.0], "needs 3 entries")],
)
def test_a_preference_that_makes_no_sense_stops_it(driver, preference, sentence):
    *speeds, reason = driver.command(preference, 100.0)
    assert speeds == [0, 0]
    assert sentence in reason


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda m: m["scan"].ranges.fill(math.nan), "The scan says nothing of"),
        (lambda m: setattr(m["odometry"].pose.pose.position, "x", math.nan), "pose must be 3 finite numbers"),
        (lambda m: setattr(m["odometry"].pose.pose.orientation, "w", math.nan), "unit quaternion, got the length nan"),
        (lambda m: setattr(m["goal"].pose.position, "y", math.inf), "goal must be 2 finite numbers"),
        (lambda m: setattr(m["odometry"].pose.pose.orientation, "w", 0.0), "unit quaternion"),
    ],
)
def test_a_message_that_makes_no_sense_stops_it(driver, change, sentence):
    change(driver.messages)
    *speeds, reason = driver.command(DISTANCE, 100.0)
    assert speeds == [0, 0]
    assert sentence in reason


def test_nobody_in_sight_is_no_reason_to_stop(driver):
    driver.messages["people"].poses.clear()
    assert driver.command(DISTANCE, 100.0)[2] == ""
