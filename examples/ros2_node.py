"""A trained policy drives a robot under ROS 2. What is missing, old, or makes no sense stops it, and is logged.

    python ros2_node.py --ros-args -p run:=results/default -p preference:="[0.2, 0.3, 0.5]" -p mount:="[0.1, 0.0, 0.0]"

Reads ``scan``, ``odom``, ``people`` (a PoseArray of who is tracked, empty for nobody) and ``goal_pose``, the last two
in the frame of ``odom``. Publishes ``cmd_vel``. The preference may be changed on the way, by ``ros2 param set``.
"""

import math
from functools import partial
from typing import Any

import torch

import morlnav
from morlnav.navigation.deployment import Observer


class Driver:
    """From the last messages to a command, without ROS.

    Args:
        policy: as :func:`morlnav.load` gives it.
        mount: x, y (m) and yaw (rad) of the scanner in the robot's frame.
        max_age: seconds after which a scan, an odometry or the people are too old to drive by.
        goal_radius: in metres, as in training.
    """

    def __init__(self, policy, mount=(0.0, 0.0, 0.0), max_age: float = 0.5, goal_radius: float = 0.35) -> None:
        self.policy, self.observer = policy, Observer.of(policy, mount=mount)
        self.max_age, self.goal_radius = max_age, goal_radius
        self.needed = ["scan", "odometry", *(["people"] if self.observer.observe_human else [])]
        self.messages: dict[str, Any] = {}

    def command(self, preference: list[float], now: float) -> tuple[float, float, str]:
        """v (m/s) and ω (rad/s) to hold for one control step, and why the robot stops, if it does.

        Args:
            preference: λ, one weight per objective of the policy.
            now: in seconds, on the clock of the messages' stamps.
        """
        try:
            return (*self._drive(preference, now), "")
        except ValueError as error:
            return 0.0, 0.0, str(error)

    def _drive(self, preference: list[float], now: float) -> list[float]:
        for name in self.needed:
            if name not in self.messages:
                raise ValueError(f"There is no message of {name} yet.")
            stamp = self.messages[name].header.stamp
            age = now - (stamp.sec + 1e-9 * stamp.nanosec)
            if not abs(age) <= self.max_age:  # one from the future tells of clocks that differ
                raise ValueError(
                    f"The last message of {name} is {age:.2f} s old, at most {self.max_age} s are allowed."
                )
        if "goal" not in self.messages:
            raise ValueError("There is no goal yet.")
        frame = self.messages["odometry"].header.frame_id
        for name in {"goal", *self.needed} - {"scan", "odometry"}:
            if (other := self.messages[name].header.frame_id) != frame:
                raise ValueError(f"The frame of {name} must be that of the odometry, {frame}, got {other}.")
        pose = planar(self.messages["odometry"].pose.pose)
        goal = self.messages["goal"].pose.position
        goal = goal.x, goal.y
        if math.dist(pose[:2], goal) <= self.goal_radius:
            raise ValueError("The goal is reached.")
        people = None
        if "people" in self.needed:
            people = [[person.position.x, person.position.y] for person in self.messages["people"].poses]
        observation = self.observer(self.messages["scan"], pose, goal, people)
        return self.policy(observation, torch.tensor(preference)).tolist()


def planar(pose: Any) -> tuple[float, float, float]:
    """x, y and heading of a pose with a quaternion."""
    q = pose.orientation
    norm = math.hypot(q.x, q.y, q.z, q.w)
    if not 0.9 < norm < 1.1:
        raise ValueError(f"A pose's orientation must be a unit quaternion, got the length {norm:g}.")
    heading = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    return pose.position.x, pose.position.y, heading


def main() -> None:
    """The node."""
    import rclpy
    from geometry_msgs.msg import PoseArray, PoseStamped, Twist
    from nav_msgs.msg import Odometry
    from rclpy.qos import qos_profile_sensor_data
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import LaserScan

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # or nothing could be published at the end
    node = rclpy.create_node("morlnav")
    policy = morlnav.load(node.declare_parameter("run", "results/default").value)
    equal = [1.0 / len(policy.objectives)] * len(policy.objectives)
    node.declare_parameter("preference", equal)
    mount = node.declare_parameter("mount", [0.0, 0.0, 0.0]).value
    driver = Driver(policy, mount, node.declare_parameter("max_age", 0.5).value)
    topics = {"scan": (LaserScan, "scan"), "odometry": (Odometry, "odom"), "people": (PoseArray, "people")}
    for name in driver.needed:
        node.create_subscription(*topics[name], partial(driver.messages.__setitem__, name), qos_profile_sensor_data)
    node.create_subscription(PoseStamped, "goal_pose", partial(driver.messages.__setitem__, "goal"), 1)
    wheels = node.create_publisher(Twist, "cmd_vel", 1)

    def tick() -> None:
        now = node.get_clock().now().nanoseconds * 1e-9
        command = Twist()
        command.linear.x, command.angular.z, reason = driver.command(node.get_parameter("preference").value, now)
        wheels.publish(command)
        if reason:
            node.get_logger().warning(reason, throttle_duration_sec=2.0)

    node.create_timer(0.2, tick)  # the step_time of the world that the policy was trained in
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        wheels.publish(Twist())
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
