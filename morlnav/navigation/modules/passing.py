"""Oracles that pass the human on a smooth path: at any distance, slowly, or after waiting."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from morlnav.limits import check_positive
from morlnav.navigation.modules.oracle import Oracle, Plan
from morlnav.navigation.world.geometry import wrap_angle


class PassingOracle(Oracle):
    """The path of a taut string from here to the goal around a circle about the human.

    The robot drives along the tangent to the circle, follows the circle, and leaves it along the tangent to the goal:
    without corners, unlike :class:`CircumnavigationOracle`. It passes on its side of the human in any case, also where
    the straight line leads by on the other; inside the circle it drives outward. Boxes are ignored.

    Args:
        radius: of the circle in metres.
        clockwise: pass with the human on the right, on the left of the human; otherwise the mirror image.
        settings: further arguments of :class:`Oracle`.

    Raises:
        ValueError: if a number is not positive.

    Examples:
        >>> observation = torch.zeros(34)
        >>> observation[0], observation[2] = 8.0, 4.0  # goal and human straight ahead
        >>> speed, turn = PassingOracle(radius=2.0)(observation)  # the tangent is 30° to the left
        >>> round(0.2 * turn.item(), 4)
        0.5236
    """

    def __init__(self, radius: float = 2.0, clockwise: bool = True, **settings: Any) -> None:
        super().__init__(**settings)
        check_positive(radius=radius)
        self.radius = radius
        self.clockwise = clockwise

    def plan(self, goal: Tensor, human: Tensor) -> Plan:
        """See :meth:`Oracle.plan`."""
        side = 1 if self.clockwise else -1  # the mirror image is planned in a mirrored frame
        goal_distance, goal_bearing = goal[..., 0], side * goal[..., 1]
        human_distance, human_bearing = human[..., 0].clamp_min(1e-6), side * human[..., 1]

        # At the human, the robot stands at `angle` from the goal, and tangents take up `slack` of it.
        ray = human_bearing + torch.pi
        axis_x = goal_distance * goal_bearing.cos() + human_distance * ray.cos()
        axis_y = goal_distance * goal_bearing.sin() + human_distance * ray.sin()
        angle = wrap_angle(ray - torch.atan2(axis_y, axis_x))
        slack = self._slack(human_distance) + self._slack(torch.hypot(axis_x, axis_y))
        leaving = angle.abs() <= slack

        depth = (self.radius / human_distance - 1).clamp(0, 1)  # 0 on the circle, 1 far inside
        swing = torch.where(
            human_distance > self.radius,
            (self.radius / human_distance).clamp_max(1).asin(),
            torch.pi / 2 * (1 + depth),
        )
        tangent = (human_distance.square() - self.radius**2).clamp_min(0).sqrt()
        follows = ~leaving & (tangent < self.speed * self.step_time)
        return Plan(
            course=side * torch.where(leaving, goal_bearing, human_bearing + swing),
            curvature=side * torch.where(follows, -1 / self.radius, 0.0),
            distance=goal_distance,
        )

    def _slack(self, distance: Tensor) -> Tensor:
        """The angle at the human between a point at ``distance`` and where its tangent touches the circle."""
        return (self.radius / distance).clamp_max(1).acos()


class SlowPassingOracle(PassingOracle):
    """Passes as :class:`PassingOracle` does, but slowly as long as the human is near.

    The speed falls from full at ``reach`` to ``slow`` halfway between there and the circle.

    Args:
        radius: of the circle in metres.
        slow: speed near the human in m/s.
        reach: distance to the human in metres from which on the robot slows down.
        settings: further arguments of :class:`PassingOracle`.

    Raises:
        ValueError: if a number is not positive, ``reach`` is not beyond the circle, or ``slow`` is above ``speed``.

    Examples:
        >>> far, near = torch.zeros(2, 34)
        >>> far[0], far[2], near[0], near[2], near[3] = 8.0, 4.0, 5.0, 1.0, -torch.pi / 2  # near: abreast of the human
        >>> SlowPassingOracle(radius=1.0)(torch.stack([far, near]))[:, 0].round(decimals=2)
        tensor([0.4400, 0.2000])
    """

    def __init__(self, radius: float = 1.0, slow: float = 0.2, reach: float = 2.0, **settings: Any) -> None:
        super().__init__(radius, **settings)
        check_positive(slow=slow)
        if reach <= radius or slow > self.speed:
            raise ValueError(
                f"The oracle needs reach > radius and slow <= speed, got {reach}, {radius}, {slow}, {self.speed}."
            )
        self.slow = slow
        self.reach = reach

    def plan(self, goal: Tensor, human: Tensor) -> Plan:
        """See :meth:`Oracle.plan`."""
        middle = (self.reach + self.radius) / 2
        share = ((human[..., 0] - middle) / (self.reach - middle)).clamp(0, 1)
        return super().plan(goal, human)._replace(limit=self.slow + share * (self.speed - self.slow))


class WaitingOracle(PassingOracle):
    """Waits before the human, then passes as :class:`PassingOracle` does.

    A memoryless policy cannot count, so the wait is a place: on its way to the human the robot creeps through a ring
    around the human, ``depth`` wide, which takes it ``pause`` seconds. A clone can learn this.

    Args:
        radius: of the circle in metres.
        pause: seconds that the robot takes for the ring.
        distance: inner radius of the ring in metres.
        depth: of the ring in metres.
        settings: further arguments of :class:`PassingOracle`.

    Raises:
        ValueError: if a number is not positive, or the ring is not beyond the circle.

    Examples:
        >>> observation = torch.zeros(34)
        >>> observation[0], observation[2], observation[3] = 6.0, 1.9, -0.55  # in the ring, nearly on the tangent
        >>> WaitingOracle(pause=4.0, depth=0.2)(observation)[0].round(decimals=3)
        tensor(0.0590)
    """

    def __init__(
        self, radius: float = 1.0, pause: float = 4.0, distance: float = 1.8, depth: float = 0.2, **settings: Any
    ) -> None:
        super().__init__(radius, **settings)
        check_positive(pause=pause, depth=depth)
        if distance <= radius:
            raise ValueError(f"The oracle waits outside its circle: distance must exceed {radius}, got {distance}.")
        self.pause = pause
        self.distance = distance
        self.depth = depth

    def plan(self, goal: Tensor, human: Tensor) -> Plan:
        """See :meth:`Oracle.plan`."""
        path = super().plan(goal, human)
        nears = (path.course - human[..., 1]).cos()  # metres nearer to the human per metre driven
        ahead = (human[..., 0] - self.distance - self.depth).clamp_min(0)  # of the ring
        slowest = torch.maximum(ahead / self.step_time, torch.full_like(ahead, self.depth / self.pause))
        waits = (human[..., 0] >= self.distance) & (nears > 0)
        limit = torch.where(waits, slowest / nears.clamp_min(1e-6), self.speed)
        return path._replace(limit=limit.clamp_max(self.speed))
