"""Plane geometry on batches: frames, and signed distances to boxes."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import torch
from torch import Tensor
from torch.linalg import vector_norm

Angle = TypeVar("Angle", Tensor, np.ndarray)


def wrap_angle(angle: Angle) -> Angle:
    """Wrap an angle in radians to ``[-π, π)``.

    >>> wrap_angle(torch.tensor(3 * torch.pi / 2))
    tensor(-1.5708)
    """
    return (angle + torch.pi) % (2 * torch.pi) - torch.pi


def to_frame(point: Tensor, origin: Tensor, angle: Tensor) -> Tensor:
    """Express ``point`` ``[..., 2]`` in the frame at ``origin`` ``[..., 2]`` turned by ``angle`` ``[...]``.

    >>> to_frame(torch.tensor([1.0, 1.0]), torch.tensor([1.0, 0.0]), torch.tensor(0.0))
    tensor([0., 1.])
    """
    dx, dy = (point - origin).unbind(-1)
    cos, sin = angle.cos(), angle.sin()
    return torch.stack([cos * dx + sin * dy, cos * dy - sin * dx], -1)


def distance_to_box(point: Tensor, box: Tensor) -> Tensor:
    """Signed distance in metres from ``point`` ``[..., 2]`` to the surface of ``box`` ``[..., 5]``; negative inside.

    >>> distance_to_box(torch.tensor([2.0, 0.0]), torch.tensor([0.0, 0.0, 1.0, 0.5, 0.0]))
    tensor(1.)
    """
    outside = to_frame(point, box[..., :2], box[..., 4]).abs() - box[..., 2:4]
    return vector_norm(outside.clamp_min(0), dim=-1) + outside.amax(-1).clamp_max(0)


def polar(point: Tensor, pose: Tensor) -> Tensor:
    """Distance (m) and bearing (rad, counter-clockwise positive) of ``point`` ``[..., 2]`` from ``pose`` ``[..., 3]``.

    >>> polar(torch.tensor([0.0, 2.0]), torch.tensor([0.0, 0.0, 0.0]))
    tensor([2.0000, 1.5708])
    """
    x, y = (point - pose[..., :2]).unbind(-1)
    return torch.stack([torch.hypot(x, y), wrap_angle(torch.atan2(y, x) - pose[..., 2])], -1)
