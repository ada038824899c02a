"""From what a robot measures to what its policy was trained to see."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from morlnav.deployment import Policy
from morlnav.navigation.world import Lidar
from morlnav.navigation.world.geometry import polar, wrap_angle

LARGEST_ROBOT = 5.0
"""Metres from a robot's centre beyond which no scanner is mounted."""
FEW = 3
"""Different readings far beyond ``range_max`` that a scanner may have for no echo."""


class LaserScan(Protocol):
    """What is read of a scan; a ``sensor_msgs/LaserScan`` of ROS has it. Ray ``i`` points to ``angle_min +
    i·angle_increment`` (rad, counter-clockwise, the increment may be negative) in the scanner's frame."""

    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: Sequence[float]


class Observer:
    """Makes a policy's observation from a scan, the robot's pose, the goal, and the humans that are tracked.

    Of a scan's readings, as ROS means them (REP 117):

    - 0, infinity and what is beyond ``range_max`` are no echo: nothing is there;
    - ``-inf`` and what is nearer than ``range_min`` are something too near to measure: they count as ``range_min``;
    - NaN is a measurement that failed: the ray says nothing.

    A sector that no ray tells of reads as free behind the robot, which only drives forward, and is refused within
    ``field`` of straight ahead. A ray wider than a sector stands for all sectors whose middle it covers.

    Of several humans the nearest counts. A policy that has always had one in sight is told of nobody by a human where
    it never mattered: at ``human_reach``, straight behind. So it is told of humans further than that, or whose place is
    not finite. A goal further than ``goal_reach`` is seen in its direction at that distance. Both default to what
    training has shown by default.

    Args:
        lidar: that the policy was trained with; its ``sectors`` and ``max_range`` count.
        observe_human: whether the policy is told of the human.
        mount: x, y (m) and yaw (rad) of the scanner in the robot's frame.
        field: angle to either side of straight ahead (rad) that the scanner has to measure.
        human_reach: in metres.
        goal_reach: in metres.

    Raises:
        ValueError: for a mount of other than three finite numbers, or off the robot, an angle outside 0 to π, or a
            reach that is not positive.

    Examples:
        >>> from types import SimpleNamespace
        >>> turn = {"angle_min": 0.0, "angle_increment": 2 * math.pi / 360, "range_min": 0.1, "range_max": 10.0}
        >>> scan = SimpleNamespace(**turn, ranges=[2.0] + [math.inf] * 359)
        >>> observation = Observer()(scan, pose=(1.0, 0.0, 0.0), goal=(4.0, 0.0), humans=[(1.0, 2.0), (1.0, -5.0)])
        >>> observation[:4], observation[18:20]
        (tensor([3.0000, 0.0000, 2.0000, 1.5708]), tensor([4., 2.]))
    """

    def __init__(
        self,
        lidar: Lidar | None = None,
        observe_human: bool = True,
        mount: Sequence[float] = (0.0, 0.0, 0.0),
        field: float = math.pi / 2,
        human_reach: float = 6.0,
        goal_reach: float = 12.0,
    ) -> None:
        if not 0 <= field <= math.pi:
            raise ValueError(f"field must be an angle from 0 to π, got {field}.")
        if not (0 < human_reach < math.inf and 0 < goal_reach < math.inf):
            raise ValueError(f"human_reach and goal_reach must be positive, got {human_reach} and {goal_reach}.")
        self.lidar, self.observe_human = lidar or Lidar(), observe_human
        self.mount, self.field = _finite("mount", mount, 3), field
        if self.mount[:2].norm() > LARGEST_ROBOT or self.mount[2].abs() > 2 * math.pi + 0.01:
            raise ValueError(
                f"mount must be x and y on the robot in metres, and a yaw in rad, got {self.mount.tolist()}; are these "
                f"in other units?"
            )
        self.human_reach, self.goal_reach = human_reach, goal_reach

    @classmethod
    def of(cls, policy: Policy, **settings: Any) -> Observer:
        """The observer of a trained policy, which knows its lidar and whether it is told of the human.

        Args:
            policy: as :func:`morlnav.load` gives it.
            settings: the other arguments.

        Raises:
            ValueError: if the policy's features do not tell.

        Examples:
            >>> import morlnav
            >>> Observer.of(morlnav.load("results/default"), mount=(0.1, 0.0, 0.0)).lidar.sectors
            30
        """
        features = policy.actor.features
        try:
            sectors, reach, observe_human = features.sectors, features.lidar_range, features.observe_human
        except AttributeError as error:
            kind = type(features).__name__
            raise ValueError(
                f"A policy with {kind} for features tells no lidar; give it as Observer(lidar)."
            ) from error
        return cls(Lidar(sectors, sectors, reach), observe_human, **settings)

    def __call__(
        self,
        scan: LaserScan,
        pose: Sequence[float],
        goal: Sequence[float],
        humans: Sequence[Sequence[float]] | None = None,
    ) -> Tensor:
        """The observation ``[4 + sectors]``, or ``[2 + sectors]`` for a policy that is not told of the human.

        Args:
            scan: of the scanner.
            pose: of the robot, x, y (m) and heading (rad) in any fixed frame.
            goal: x, y in the same frame.
            humans: x, y of each in the same frame, ``[K, 2]``, empty for nobody; ``None`` where the policy is not told.

        Raises:
            ValueError: for numbers that are not finite, of another shape, or make no sense; for humans where the policy
                is not told of them, or none where it is; for a scan that says nothing of a sector ahead.
        """
        pose, goal = _finite("pose", pose, 3), _finite("goal", goal, 2)
        if (humans is not None) != self.observe_human:
            known = "is told of the human: give humans, [] for nobody" if self.observe_human else "is told of no humans"
            raise ValueError(f"This policy {known}.")
        seen = polar(goal, pose)
        seen[0].clamp_(max=self.goal_reach)
        human = [] if humans is None else [self._human(humans, pose)]
        return torch.cat([seen, *human, self.scan(scan)]).float()

    def _human(self, humans: Sequence[Sequence[float]], pose: Tensor) -> Tensor:
        """Distance and bearing of the nearest, ``[2]``."""
        places = _numbers("humans", humans)
        if places.numel() and (places.ndim != 2 or places.shape[1] != 2):
            raise ValueError(f"humans must be x and y of each, [K, 2], got the shape {list(places.shape)}.")
        places = places.reshape(-1, 2)
        seen = polar(places[places.isfinite().all(-1)], pose)
        seen = seen[seen[:, 0] <= self.human_reach]
        return seen[seen[:, 0].argmin()] if len(seen) else seen.new_tensor([self.human_reach, -math.pi])

    def scan(self, scan: LaserScan) -> Tensor:
        """The least distance from the robot's centre in each sector, ``[sectors]`` in metres.

        Raises:
            ValueError: as for the whole observation.
        """
        angle, reading = self._rays(scan)
        sectors, width = self.lidar.sectors, 2 * math.pi / self.lidar.sectors
        x, y, yaw = self.mount
        course = yaw + angle

        def seen(distance: Tensor) -> Tensor:
            """Distance and bearing ``[N, 2]`` from the robot's centre of points along the rays."""
            ends = torch.stack([x + distance * course.cos(), y + distance * course.sin()], -1)
            return polar(ends, torch.zeros(3, dtype=ends.dtype))

        def sector(bearing: Tensor) -> Tensor:
            return ((bearing + math.pi) / width + 1e-4).long() % sectors  # rays on the border belong to the next one

        far = self.lidar.max_range + torch.hypot(x, y)
        end, direction = seen(reading.clamp(max=far)), seen(far.expand_as(reading))[:, 1]
        least = torch.full((sectors,), self.lidar.max_range, dtype=end.dtype)
        least = least.scatter_reduce(0, sector(end[:, 1]), end[:, 0], "amin")
        told = torch.zeros(sectors, dtype=torch.bool)
        told[sector(direction)] = True
        middle = (torch.arange(sectors, dtype=end.dtype) + 0.5) * width - math.pi
        if len(angle):
            off, ray = wrap_angle(direction - middle.unsqueeze(1)).abs().min(1)
            covered = ~told & (off <= abs(scan.angle_increment) / 2 + 1e-6)
            least, told = torch.where(covered, end[ray, 0].clamp(max=self.lidar.max_range), least), told | covered
        untold = middle[~told & (middle.abs() <= self.field + 1e-6)]
        if len(untold):
            raise ValueError(
                f"The scan says nothing of {len(untold)} sectors within {math.degrees(self.field):.0f}° of straight "
                f"ahead, such as the one at {math.degrees(untold[untold.abs().argmin()]):.0f}°."
            )
        return least

    def _rays(self, scan: LaserScan) -> tuple[Tensor, Tensor]:
        """Angle from the scanner (rad) and reading (m, infinite without an echo) of the rays that tell, ``[N]``."""
        missing = [name for name in LaserScan.__annotations__ if not hasattr(scan, name)]
        if missing:
            raise ValueError(f"A scan needs {', '.join(LaserScan.__annotations__)}; there is no {missing[0]}.")
        ranges = _numbers("scan.ranges", scan.ranges)
        if ranges.ndim != 1 or not len(ranges):
            raise ValueError(f"scan.ranges must be one row of distances, got the shape {list(ranges.shape)}.")
        first, step = _finite("scan.angle_min and angle_increment", [scan.angle_min, scan.angle_increment], 2)
        if abs(first) > 4 * math.pi:
            raise ValueError(f"scan.angle_min must be an angle in rad, got {first:g}; is it in degrees?")
        if step == 0 or abs(step) * (len(ranges) - 1) > 2.02 * math.pi:
            raise ValueError(
                f"scan.angle_increment must turn {len(ranges)} rays by 2π at most, got {step:g}; is it in degrees?"
            )
        near_end, far_end = _numbers("scan.range_min and range_max", [scan.range_min, scan.range_max])
        if not 0 <= near_end < far_end:
            raise ValueError(f"scan.range_min and range_max must ascend from 0, got {near_end:g} and {far_end:g}.")
        beyond = ranges[(ranges > 10 * far_end) & ranges.isfinite()].unique()
        if len(beyond) > FEW:  # no echo is one number, or two
            raise ValueError(
                f"scan.ranges reach {beyond.max():g}, range_max is {far_end:g} m; are they in millimetres?"
            )
        negative = (ranges < 0) & ranges.isfinite()
        if negative.any():
            ray = int(negative.nonzero()[0])
            raise ValueError(f"scan.ranges[{ray}] must be a distance in metres, got {ranges[ray]:g}.")
        near = (ranges == -math.inf) | ((ranges > 0) & (ranges < near_end))
        reading = ranges.masked_fill(near, near_end.item())
        reading = reading.masked_fill((ranges == 0) | (ranges > far_end), math.inf)
        told = ~ranges.isnan()
        return (first + step * torch.arange(len(ranges)))[told], reading[told]


def _numbers(name: str, values: Any) -> Tensor:
    values = values.detach().cpu() if isinstance(values, Tensor) else values
    values = values.filled(math.nan) if isinstance(values, np.ma.MaskedArray) else values
    try:
        return torch.from_numpy(np.asarray(values, np.float64).copy())
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be numbers, in rows of one length, got {type(values).__name__}.") from error


def _finite(name: str, values: Any, count: int) -> Tensor:
    """Finite numbers ``[count]``."""
    numbers = _numbers(name, values)
    if numbers.shape != (count,) or not numbers.isfinite().all():
        raise ValueError(f"{name} must be {count} finite numbers, got {numbers.tolist()}.")
    return numbers
