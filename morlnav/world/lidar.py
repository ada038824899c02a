"""A planar lidar: ray casting against the human's circle and rotated boxes, min-pooled to sectors."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from morlnav.world.geometry import to_frame


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
        >>> from morlnav.world import SceneSampler
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
        if self.max_range <= 0:
            raise ValueError(f"The lidar's max_range must be positive, got {self.max_range}.")

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
        angles = self.angles(pose.device).to(pose.dtype)
        cos, sin = angles.cos(), angles.sin()
        # The human, in the robot's frame: the nearer root of |t·u - c| = r.
        centre = to_frame(human, pose[..., :2], pose[..., 2])
        along = centre[:, :1] * cos + centre[:, 1:] * sin
        across = centre[:, :1] * sin - centre[:, 1:] * cos
        gap = human_radius**2 - across.square()
        root = gap.clamp_min(0).sqrt()
        nearest = torch.where((gap >= 0) & (along + root >= 0), along - root, self.max_range)
        # The boxes, each in its own frame, where a ray is tested against two slabs.
        origin = to_frame(pose[:, None, :2], boxes[..., :2], boxes[..., 4])
        turn = pose[:, None, 2] - boxes[..., 4]
        turn_cos, turn_sin = turn.cos().unsqueeze(-1), turn.sin().unsqueeze(-1)
        # The offset keeps a ray that runs exactly along a side from turning into ∞ - ∞.
        inv_x = (turn_cos * cos - turn_sin * sin).add_(1e-20).reciprocal_()
        inv_y = (turn_sin * cos + turn_cos * sin).add_(1e-20).reciprocal_()
        mid_x, mid_y = -origin[..., :1] * inv_x, -origin[..., 1:] * inv_y
        span_x, span_y = boxes[..., 2:3] * inv_x.abs_(), boxes[..., 3:4] * inv_y.abs_()
        enter = torch.maximum(mid_x - span_x, mid_y - span_y)
        leave = torch.minimum(mid_x + span_x, mid_y + span_y)
        enter = torch.where((enter <= leave) & (leave >= 0), enter, self.max_range)
        if boxes.shape[-2]:
            nearest = torch.minimum(nearest, enter.amin(-2))
        return nearest.clamp_(0, self.max_range)

    def scan(self, pose: Tensor, human: Tensor, boxes: Tensor, human_radius: float) -> Tensor:
        """The pooled scan ``[B, sectors]`` in metres; arguments as in :meth:`cast`."""
        return self.pool(self.cast(pose, human, boxes, human_radius))
