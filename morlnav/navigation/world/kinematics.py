"""How a differential-drive robot moves under constant velocity commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from morlnav.limits import check_positive
from morlnav.navigation.world.geometry import wrap_angle


class Robot(Protocol):
    """What a world needs of a robot, of whatever kind; see :class:`DifferentialDrive`."""

    radius: float
    max_speed: float
    max_turn: float

    @property
    def action_low(self) -> Tensor:
        """Least action, shape ``[2]``."""

    @property
    def action_high(self) -> Tensor:
        """Largest action, shape ``[2]``."""

    def limit(self, action: Tensor) -> Tensor:
        """What the motors make of an action ``[..., 2]``."""

    def move(self, pose: Tensor, action: Tensor, duration: float | Tensor) -> Tensor:
        """The pose ``[..., 3]`` after so many seconds of a constant action."""


@dataclass(frozen=True)
class DifferentialDrive:
    """A round robot with two driven wheels (Sec. III-B.1).

    Args:
        radius: body radius in metres.
        max_speed: largest linear velocity in m/s; the least is 0.
        max_turn: largest angular velocity in rad/s, either way.

    Raises:
        ValueError: if a value is not positive.

    Examples:
        >>> robot = DifferentialDrive()
        >>> robot.move(torch.zeros(3), torch.tensor([0.5, 0.0]), 0.2)
        tensor([0.1000, 0.0000, 0.0000])
    """

    radius: float = 0.18
    max_speed: float = 0.5
    max_turn: float = torch.pi

    def __post_init__(self) -> None:
        check_positive(radius=self.radius, max_speed=self.max_speed, max_turn=self.max_turn)

    @property
    def action_low(self) -> Tensor:
        """Least action ``(v, ω)``, shape ``[2]``."""
        return torch.tensor([0.0, -self.max_turn])

    @property
    def action_high(self) -> Tensor:
        """Largest action ``(v, ω)``, shape ``[2]``."""
        return torch.tensor([self.max_speed, self.max_turn])

    def limit(self, action: Tensor) -> Tensor:
        """What the motors make of an action ``[..., 2]``: the nearest one within the bounds.

        >>> DifferentialDrive().limit(torch.tensor([-1.0, 4.0]))
        tensor([0.0000, 3.1416])
        """
        v, w = action.unbind(-1)
        return torch.stack([v.clamp(0.0, self.max_speed), w.clamp(-self.max_turn, self.max_turn)], -1)

    def move(self, pose: Tensor, action: Tensor, duration: float | Tensor) -> Tensor:
        """Follow the exact arc of constant ``action`` ``[..., 2]`` from ``pose`` ``[..., 3]`` for ``duration`` s."""
        v, w = action.unbind(-1)
        x, y, heading = pose.unbind(-1)
        half = w * (duration / 2)
        chord = v * duration * torch.sinc(half / torch.pi)
        course = heading + half
        return torch.stack(
            [x + chord * course.cos(), y + chord * course.sin(), wrap_angle(heading + 2 * half)],
            -1,
        )

    def action_between(self, pose: Tensor, next_pose: Tensor, duration: float | Tensor) -> Tensor:
        """The inverse of :meth:`move`: the action ``[..., 2]`` whose arc leads from one pose ``[..., 3]`` to the next.

        Of a motion that no arc makes, the part sideways is lost; neither speed is limited to what the robot can do.

        >>> robot = DifferentialDrive()
        >>> robot.action_between(torch.zeros(3), torch.tensor([0.1, 0.0, 0.0]), 0.2)
        tensor([0.5000, 0.0000])
        """
        x, y = (next_pose - pose)[..., :2].unbind(-1)
        turn = wrap_angle(next_pose[..., 2] - pose[..., 2])
        course = pose[..., 2] + turn / 2
        chord = x * course.cos() + y * course.sin()
        return torch.stack([chord / torch.sinc(turn / (2 * torch.pi)), turn], -1) / torch.as_tensor(
            duration, dtype=pose.dtype
        ).unsqueeze(-1)
