"""The directional angle between an interpolated preference and a value vector (Eq. 1), in two forms."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class AngleTerm(nn.Module):
    """Penalty ``g(λ_p, Q)`` of the actor's and the critic's loss.

    Args:
        actor: coefficient in the actor's loss (``α = 10`` in the paper, for unscaled rewards).
        critic: coefficient in the critic's loss.
        degrees: give the angle in degrees, as PD-MORL's reference implementation does, instead of radians.
        eps: keeps norms away from zero.

    Examples:
        >>> g = AngleTerm()
        >>> round(g(torch.tensor([1.0, 0.0]), torch.tensor([-1.0, 1.0])).item(), 4)
        2.3562
    """

    def __init__(self, actor: float = 1.0, critic: float = 0.0, degrees: bool = False, eps: float = 1e-6) -> None:
        super().__init__()
        if actor < 0 or critic < 0:
            raise ValueError(f"Angle coefficients must not be negative, got actor={actor} and critic={critic}.")
        self.actor = actor
        self.critic = critic
        self.degrees = degrees
        self.eps = eps

    def forward(self, direction: Tensor, value: Tensor) -> Tensor:
        """Angle between ``direction`` ``[..., m]`` and ``value`` ``[..., m]``, shape ``[...]``."""
        angle = self.angle(self._unit(direction), self._unit(value))
        return angle.rad2deg() if self.degrees else angle

    def _unit(self, vector: Tensor) -> Tensor:
        return vector / (vector.square().sum(-1, keepdim=True) + self.eps**2).sqrt()

    def angle(self, a: Tensor, b: Tensor) -> Tensor:
        """Angle of unit vectors by ``2·atan2(|a - b|, |a + b|)``: exact and with a gradient up to 180°."""
        apart = ((a - b).square().sum(-1) + self.eps**2).sqrt()
        along = ((a + b).square().sum(-1) + self.eps**2).sqrt()
        return 2 * torch.atan2(apart, along)


class ClampedAngleTerm(AngleTerm):
    """The form of PD-MORL's reference implementation: the cosine is clamped to ``[0, 0.9999]``.

    Beyond 90° its gradient is exactly zero; kept for faithful comparisons.

    Examples:
        >>> ClampedAngleTerm(degrees=True)(torch.tensor([1.0, 0.0]), torch.tensor([-1.0, 1.0]))
        tensor(90.)
    """

    def angle(self, a: Tensor, b: Tensor) -> Tensor:
        """Angle of unit vectors by the arc cosine of their clamped product."""
        return torch.acos((a * b).sum(-1).clamp(0.0, 0.9999))
