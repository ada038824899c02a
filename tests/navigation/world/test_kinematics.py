"""The robot's arc, against values worked out by hand and against many small steps."""

import math

import pytest
import torch

from morlnav.navigation.world import DifferentialDrive


def test_without_turning_the_robot_drives_straight():
    pose = DifferentialDrive().move(torch.tensor([1.0, 2.0, math.pi / 2]), torch.tensor([0.5, 0.0]), 2.0)
    torch.testing.assert_close(pose, torch.tensor([1.0, 3.0, math.pi / 2]))


def test_without_speed_the_robot_turns_on_the_spot():
    pose = DifferentialDrive().move(torch.tensor([1.0, 2.0, 0.0]), torch.tensor([0.0, -math.pi]), 0.25)
    torch.testing.assert_close(pose, torch.tensor([1.0, 2.0, -math.pi / 4]))


def test_a_quarter_circle_to_the_left_ends_one_radius_ahead_and_one_to_the_left():
    # v = 0.5 m/s and ω = π/2 rad/s make a circle of radius 1/π m, a quarter of it in one second.
    pose = DifferentialDrive().move(torch.zeros(3), torch.tensor([0.5, math.pi / 2]), 1.0)
    torch.testing.assert_close(pose, torch.tensor([1 / math.pi, 1 / math.pi, math.pi / 2]))


def test_the_arc_is_the_limit_of_many_small_steps():
    generator = torch.Generator().manual_seed(0)
    pose = torch.randn(64, 3, generator=generator, dtype=torch.float64)
    action = torch.rand(64, 2, generator=generator, dtype=torch.float64) * torch.tensor([0.5, 2 * math.pi])
    action[:, 1] -= math.pi
    arc = DifferentialDrive().move(pose, action, 0.2)
    steps, (x, y, heading), (v, w) = 5000, pose.unbind(-1), action.unbind(-1)
    for _ in range(steps):
        x = x + v * (0.2 / steps) * heading.cos()
        y = y + v * (0.2 / steps) * heading.sin()
        heading = heading + w * (0.2 / steps)
    torch.testing.assert_close(arc[:, :2], torch.stack([x, y], -1), atol=1e-5, rtol=0)
    torch.testing.assert_close((arc[:, 2] - heading).cos(), torch.ones(64, dtype=torch.float64))


def test_two_halves_of_a_step_make_one_step():
    robot, pose, action = DifferentialDrive(), torch.tensor([0.3, -0.2, 3.0]), torch.tensor([0.4, 2.0])
    halves = robot.move(robot.move(pose, action, 0.1), action, 0.1)
    torch.testing.assert_close(halves, robot.move(pose, action, 0.2))
    assert -math.pi <= halves[2] < math.pi


@pytest.mark.parametrize("name", ["radius", "max_speed", "max_turn"])
def test_a_robot_without_size_or_speed_is_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be positive, got 0"):
        DifferentialDrive(**{name: 0.0})
