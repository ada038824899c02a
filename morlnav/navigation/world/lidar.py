"""A planar lidar: ray casting against the human's circle and rotated boxes, min-pooled to sectors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import torch
import torch.nn.functional as F
from torch import Tensor

from morlnav.limits import check_positive
from morlnav.navigation.world.geometry import to_frame


@dataclass(frozen=True)
class Lidar:
    """A 360° scanner (Sec. III-B.1): ray ``j`` points to robot-frame angle ``-π + j·2π/rays``.

    Args:
        rays: rays per revolution.
        sectors: sectors that the rays are min-pooled to; must divide ``rays``.
        max_range: readings are clipped to this distance in metres.

    Raises:
        ValueError: if a value is not positive or ``sectors`` does not divide ``rays``.

    Examples:
        >>> from morlnav.navigation.world.scene import SceneSampler
        >>> scene = SceneSampler()(4)
        >>> Lidar().scan(scene.start, scene.human, scene.boxes, human_radius=0.3).shape
        torch.Size([4, 30])
    """

    rays: int = 720
    sectors: int = 30
    max_range: float = 4.0

    def __post_init__(self) -> None:
        if self.rays < 1 or self.sectors < 1 or self.rays % self.sectors:
            raise ValueError(f"{self.sectors} sectors must divide {self.rays} rays, both positive.")
        check_positive(max_range=self.max_range)

    def angles(self, device: torch.device | None = None) -> Tensor:
        """Robot-frame angles of all rays in radians, shape ``[rays]``."""
        return torch.arange(self.rays, device=device) * (2 * torch.pi / self.rays) - torch.pi

    def pool(self, distances: Tensor) -> Tensor:
        """Min-pool ray distances ``[..., rays]`` to sectors ``[..., sectors]``."""
        return distances.unflatten(-1, (self.sectors, -1)).amin(-1)

    def cast(self, pose: Tensor, human: Tensor, boxes: Tensor, human_radius: float) -> Tensor:
        """Distances in metres along every ray, clipped to the range.

        Args:
            pose: robot poses ``[B, 3]``.
            human: centres ``[B, 2]``.
            boxes: ``[B, K, 5]``.
            human_radius: in metres.

        Returns:
            Tensor of shape ``[B, rays]``; a ray that begins inside the human or a box reads 0.
        """
        angles = self.angles(pose.device).to(pose.dtype).expand(1, 1 + boxes.shape[-2], -1)
        distances = _distances(angles.cos(), angles.sin(), *_seen_from(pose, human, boxes), human_radius)
        return distances.amin(1).clamp(0, self.max_range)

    def scan(self, pose: Tensor, human: Tensor, boxes: Tensor, human_radius: float) -> Tensor:
        """The pooled scan ``[B, sectors]`` in metres: ``pool(cast(...))`` with less work; arguments as in :meth:`cast`.

        Only rays that can be a sector's nearest are cast. The rays that hit a convex obstacle lie side by side, within
        90° of the bearing of its nearest point, and read more the further they turn away from it. So a sector's nearest
        is its ray that is closest in angle to that bearing, or in the bearing's own sector one of the three around it.
        In single precision the two may differ for a robot whose very centre is on a box's surface, and nowhere else.
        """
        seen = centre, origin, turn, half = _seen_from(pose, human, boxes)
        x, y = (origin.clamp(-half, half) - origin).unbind(-1)
        bearing = torch.cat([torch.atan2(centre[:, 1:], centre[:, :1]), torch.atan2(y, x) - turn], 1)
        ray = (bearing * (self.rays / (2 * torch.pi)) + self.rays / 2).round().long() % self.rays
        cos, sin = (F.embedding(ray, table) for table in _candidates(self, pose.device, pose.dtype))
        distances = _distances(cos, sin, *seen, human_radius)
        nearest, beside = distances[..., :-2].amin(1), torch.minimum(distances[..., -2], distances[..., -1])
        sector = ray // (self.rays // self.sectors)
        return nearest.scatter_reduce(1, sector, beside, "amin").clamp(0, self.max_range)


@lru_cache(maxsize=8)
def _candidates(lidar: Lidar, device: torch.device, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Cosines and sines ``[rays, sectors + 2]`` of the rays to cast at an obstacle whose bearing is at ray ``j``.

    One per sector, the closest to ``j`` in angle, then the two beside ``j`` as far as they are in the sector of ``j``.
    """
    ray, width = torch.arange(lidar.rays, device=device).unsqueeze(1), lidar.rays // lidar.sectors
    first = ray[::width].T
    last = first + width - 1
    closest = torch.where((first - ray) % lidar.rays < (ray - last) % lidar.rays, first, last)
    closest = torch.where(ray // width == first // width, ray, closest)
    beside = torch.cat([ray - 1, ray + 1], 1) % lidar.rays
    index = torch.cat([closest, torch.where(beside // width == ray // width, beside, ray)], 1)
    angles = lidar.angles(device).to(dtype)
    return angles.cos()[index], angles.sin()[index]


def _seen_from(pose: Tensor, human: Tensor, boxes: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The human in the robot's frame ``[B, 2]``; the robot's place and heading in each box's, and half its sides."""
    centre = to_frame(human, pose[:, :2], pose[:, 2])
    origin = to_frame(pose[:, None, :2], boxes[..., :2], boxes[..., 4])
    return centre, origin, pose[:, 2:] - boxes[..., 4], boxes[..., 2:4]


def _distances(
    cos: Tensor, sin: Tensor, centre: Tensor, origin: Tensor, turn: Tensor, half: Tensor, human_radius: float
) -> Tensor:
    """Distances to the human and each box along rays of these directions ``[B, 1 + K, N]``; ∞ where a ray misses."""
    # The human: the nearer root of |t·u - c| = r.
    x, y = centre[:, :1], centre[:, 1:]
    along = x * cos[:, 0] + y * sin[:, 0]
    across = x * sin[:, 0] - y * cos[:, 0]
    gap = human_radius**2 - across.square()
    root = gap.clamp_min(1e-12).sqrt()  # 0 would have no derivative
    human = (along - root).masked_fill((gap < 0) | (along + root < 0), torch.inf)
    # The boxes, each in its own frame, where a ray is tested against two slabs.
    cos, sin, turn = cos[:, 1:], sin[:, 1:], turn.unsqueeze(-1)
    turn_cos, turn_sin = turn.cos(), turn.sin()
    # The offset keeps a ray that runs exactly along a side from turning into ∞ - ∞.
    inv_x = (turn_cos * cos - turn_sin * sin).add(1e-20).reciprocal()
    inv_y = (turn_sin * cos + turn_cos * sin).add(1e-20).reciprocal()
    mid_x, mid_y = -origin[..., :1] * inv_x, -origin[..., 1:] * inv_y
    span_x, span_y = half[..., :1] * inv_x.abs(), half[..., 1:] * inv_y.abs()
    enter = torch.maximum(mid_x - span_x, mid_y - span_y)
    leave = torch.minimum(mid_x + span_x, mid_y + span_y)
    box = enter.masked_fill((enter > leave) | (leave < 0), torch.inf)
    return torch.cat([human.unsqueeze(1), box], 1)
