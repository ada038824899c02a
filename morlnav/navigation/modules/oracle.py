"""Hand-written policies that demonstrate a navigation style."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor, nn

from morlnav.limits import check_positive
from morlnav.navigation.world.geometry import wrap_angle


class Plan(NamedTuple):
    """Where an oracle wants to go from here; every tensor has the batch shape ``[...]``.

    Attributes:
        course: direction to drive in, in the robot's frame, in radians.
        curvature: how the course turns on the way, in rad/m, counter-clockwise positive; 0 on a straight line.
        distance: to the next corner in metres; the robot stops there to turn.
        limit: speed in m/s that the robot keeps below here; ``None`` where its full speed is welcome.
    """

    course: Tensor
    curvature: Tensor
    distance: Tensor
    limit: Tensor | None = None


class Oracle(nn.Module, ABC):
    """A memoryless policy on raw observations: a subclass plans, this class steers along the plan.

    The robot takes up the planned course within one control step where its turn rate allows, drives at full ``speed``
    on course, and slows down only before a corner and while it points elsewhere: it turns at corners on the spot.

    Args:
        speed: on course, in m/s.
        max_turn: largest angular velocity in rad/s, either way.
        step_time: one control step in seconds.
        sectors: number of lidar sectors in an observation; they are not looked at.

    Raises:
        ValueError: if a number is not positive.

    Examples:
        >>> class Direct(Oracle):
        ...     def plan(self, goal, human):
        ...         return Plan(course=goal[..., 1], curvature=torch.zeros_like(goal[..., 1]), distance=goal[..., 0])
        >>> action = Direct()(torch.tensor([5.0, 0.0, 2.5, 0.1] + [4.0] * 30))
        >>> [round(value, 2) for value in action.tolist()]
        [0.5, 0.0]
    """

    def __init__(
        self, speed: float = 0.5, max_turn: float = torch.pi, step_time: float = 0.2, sectors: int = 30
    ) -> None:
        super().__init__()
        check_positive(speed=speed, max_turn=max_turn, step_time=step_time)
        self.speed = speed
        self.max_turn = max_turn
        self.step_time = step_time
        self.sectors = sectors

    @abstractmethod
    def plan(self, goal: Tensor, human: Tensor) -> Plan:
        """Plan from the polar coordinates ``[..., 2]`` (m, rad) of goal and human in the robot's frame."""

    def forward(self, observation: Tensor) -> Tensor:
        """Actions ``[..., 2]`` (m/s, rad/s) for raw observations ``[..., 4 + sectors]``.

        Raises:
            ValueError: if the last dimension does not fit.
        """
        if observation.shape[-1] != 4 + self.sectors:
            raise ValueError(
                f"An oracle needs raw observations [..., {4 + self.sectors}] that hold the human's position; "
                f"got {list(observation.shape)}."
            )
        course, curvature, distance, limit = self.plan(observation[..., :2], observation[..., 2:4])
        course = wrap_angle(course)
        speed = (self.speed if limit is None else limit) * course.cos().clamp_min(0).pow(4)
        speed = torch.minimum(speed, distance.clamp_min(0) / self.step_time)
        turn = course / self.step_time + curvature * speed
        return torch.stack([speed, turn.clamp(-self.max_turn, self.max_turn)], -1)


class CircumnavigationOracle(Oracle):
    """The paper's demonstration: straight to the human, around the human on a circle, straight to the goal.

    The robot advances to ``radius`` from the human's centre, turns 90° left, orbits the human clockwise until the goal
    is abeam (it stands on the line from the human to the goal), turns 90° away from the human and drives to the goal
    (Sec. III-D.3, Fig. 3). Boxes are ignored.

    The phase follows from where the robot is and points, so that the oracle is a function of the observation, which a
    clone can learn, and goes on sensibly from any state: off the circle it steers back to it, toward the human if
    further out than ``band``; beyond the human it drives to the goal. "Beyond" begins on the circle's point nearest the
    goal and widens to ``sector`` on either side at a distance of ``band`` from the circle, so that a robot pushed
    aside after leaving the circle does not return to it.

    Args:
        radius: of the circle in metres.
        clockwise: orbit with the human on the right; otherwise the mirror image.
        speed: on course, in m/s.
        band: distance from the circle in metres at which the robot steers straight toward or away from the human.
        sector: angle at the human, from the direction of the goal, within which the human counts as passed, in radians.
        max_turn: largest angular velocity in rad/s, either way.
        step_time: one control step in seconds.
        sectors: number of lidar sectors in an observation; they are not looked at.

    Raises:
        ValueError: if a number is not positive.

    Examples:
        >>> oracle = CircumnavigationOracle()
        >>> far, near = torch.zeros(2, 34)
        >>> far[0], far[2] = 8.0, 4.0  # goal and human straight ahead
        >>> near[0], near[2] = 5.0, 1.0  # on the circle: turn left on the spot
        >>> oracle(torch.stack([far, near])).round(decimals=4)
        tensor([[0.5000, 0.0000],
                [0.0000, 3.1416]])
    """

    tolerance = 0.01
    """A corner counts as reached from this distance on, in metres."""

    aim = math.pi / 6
    """Within this bearing of the human a robot outside the circle is approaching, in radians."""

    def __init__(
        self,
        radius: float = 1.0,
        clockwise: bool = True,
        speed: float = 0.5,
        band: float = 0.4,
        sector: float = torch.pi / 3,
        max_turn: float = torch.pi,
        step_time: float = 0.2,
        sectors: int = 30,
    ) -> None:
        super().__init__(speed, max_turn, step_time, sectors)
        check_positive(radius=radius, band=band, sector=sector)
        self.radius = radius
        self.clockwise = clockwise
        self.band = band
        self.sector = sector

    def plan(self, goal: Tensor, human: Tensor) -> Plan:
        """See :meth:`Oracle.plan`."""
        side = 1 if self.clockwise else -1  # the mirror image is planned in a mirrored frame
        goal_distance, goal_bearing = goal[..., 0], side * goal[..., 1]
        human_distance, human_bearing = human[..., 0], side * human[..., 1]
        excess = human_distance - self.radius
        offset = (excess / self.band).clamp(-1, 1)

        # The angle at the human from the goal to the robot falls to 0 on the orbit; `ahead` is what is left of it.
        ray = human_bearing + torch.pi
        axis_x = goal_distance * goal_bearing.cos() + human_distance * ray.cos()
        axis_y = goal_distance * goal_bearing.sin() + human_distance * ray.sin()
        angle = wrap_angle(ray - torch.atan2(axis_y, axis_x))
        ahead = angle - self.sector * offset.clamp_min(0)
        leaving = (angle >= -self.sector) & (self.radius * ahead <= self.tolerance)

        approaching = (offset == 1) | ((excess > self.tolerance) & (human_bearing.abs() < self.aim))
        swing = torch.where(approaching, 0.0, torch.pi / 2 * (1 - offset))  # away from the human
        arc = self.radius * torch.where(ahead > 0, ahead, ahead + 2 * torch.pi)
        return Plan(
            course=side * torch.where(leaving, goal_bearing, human_bearing + swing),
            curvature=side * torch.where(leaving, 0.0, -swing.sin() / human_distance.clamp_min(1e-6)),
            distance=torch.where(leaving, goal_distance, torch.where(approaching, excess, arc)),
        )
