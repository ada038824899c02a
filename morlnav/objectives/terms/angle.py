"""The directional angle between an interpolated preference and a value vector (Eq. 1), in two forms."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from morlnav.limits import check_at_least, check_positive
from morlnav.objectives.terms.base import Acted, Judged, LossTerm


class AngleTerm(LossTerm):
    """Penalty ``c·g(λ_p, Q)`` of the actor's and the critics' loss: values should point where the preference does.

    Args:
        actor: coefficient in the actor's loss (``α = 10`` in the paper, for unscaled rewards).
        critic: coefficient in the critics' loss.
        interpolator: maps λ to a direction ``λ_p`` ``[..., m]``, such as a
            :class:`~morlnav.modules.PreferenceInterpolator`; without one, ``λ_p`` is the weight vector. It gets no
            gradient.
        tuneable_only: leave the static entries in front out of the angle and of what the interpolator learns, whose
            :meth:`~morlnav.modules.PreferenceInterpolator.tuneable` then serves. They still count in the scalarised
            value.
        degrees: give the angle in degrees, as PD-MORL's reference implementation does, instead of radians.
        eps: keeps norms away from zero.

    Raises:
        ValueError: for a negative coefficient.

    Examples:
        >>> g = AngleTerm()
        >>> round(g(torch.tensor([1.0, 0.0]), torch.tensor([-1.0, 1.0])).item(), 4)
        2.3562
    """

    def __init__(
        self,
        actor: float = 0.05,
        critic: float = 0.0,
        interpolator: nn.Module | None = None,
        tuneable_only: bool = False,
        degrees: bool = False,
        eps: float = 1e-6,
    ) -> None:
        super().__init__()
        check_at_least(0, actor=actor, critic=critic)
        check_positive(eps=eps)
        self.coefficients = {"actor": actor, "qvalue": critic}
        static = tuneable_only and getattr(interpolator, "num_static", 0)
        self.interpolator = interpolator.tuneable() if static else interpolator
        self.tuneable_only = tuneable_only
        self.degrees = degrees
        self.eps = eps

    @property
    def adds_to(self) -> list[str]:
        """The losses with a coefficient above zero."""
        return [name for name, coefficient in self.coefficients.items() if coefficient > 0]

    def actor(self, acted: Acted) -> Tensor:
        """``[B]``, of the value that the actor climbs."""
        return self.coefficients["actor"] * self._angle(acted, acted.values)

    def critic(self, judged: Judged) -> Tensor:
        """``[k, B]``, of each critic's value."""
        return self.coefficients["qvalue"] * self._angle(judged, judged.values)

    def _angle(self, judged: Judged, value: Tensor) -> Tensor:
        first = judged.num_static if self.tuneable_only else 0
        if self.interpolator is None:
            direction = judged.weights[..., first:]
        else:
            direction = self.interpolator(judged.preference).detach()
        value = value[..., first:]
        return self(direction.expand_as(value), value)

    def attach(self, scalarisation: nn.Module) -> None:
        """Let the interpolator rank its keys as the loss weighs values."""
        if hasattr(self.interpolator, "weights"):
            self.interpolator.weights = scalarisation

    def update(self, preferences: Tensor, values: Tensor) -> None:
        """Let the interpolator learn which values were measured."""
        if self.interpolator is not None:
            first = values.shape[-1] - preferences.shape[-1] if self.tuneable_only else 0
            self.interpolator.update(preferences, values[..., first:])

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
