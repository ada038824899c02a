"""Samplers that draw preferences λ on the simplex."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import prod

import torch
from torch import Tensor
from torch.nn.functional import normalize

from morlnav.limits import check_at_least
from morlnav.simplex import simplex_grid


class PreferenceSampler(ABC):
    """Draws preferences: ``sampler(*batch_size)`` is float32 ``[*batch_size, n]``, non-negative, rows summing to 1.

    Draws come from torch's global random state, or from ``generator`` where one is given.

    Args:
        num_objectives: objectives ``n`` that a preference weighs.

    Raises:
        ValueError: if ``num_objectives`` is below 1.

    Examples:
        >>> class OnlyFirst(PreferenceSampler):
        ...     def __call__(self, *batch_size, device=None, generator=None):
        ...         return torch.eye(self.num_objectives, device=device)[0].expand(*batch_size, -1)
        >>> OnlyFirst(3)(2)
        tensor([[1., 0., 0.],
                [1., 0., 0.]])
    """

    def __init__(self, num_objectives: int) -> None:
        check_at_least(1, num_objectives=num_objectives)
        self.num_objectives = num_objectives

    @abstractmethod
    def __call__(
        self, *batch_size: int, device: torch.device | str | None = None, generator: torch.Generator | None = None
    ) -> Tensor:
        """Draws preferences ``[*batch_size, n]``."""


class UniformPreferences(PreferenceSampler):
    """Every preference is equally likely.

    Args:
        num_objectives: objectives ``n`` that a preference weighs.

    Examples:
        >>> UniformPreferences(3)(16, 4).shape
        torch.Size([16, 4, 3])
    """

    def __call__(
        self, *batch_size: int, device: torch.device | str | None = None, generator: torch.Generator | None = None
    ) -> Tensor:
        """Draws preferences ``[*batch_size, n]``."""
        return _uniform(batch_size, self.num_objectives, device, generator)


class DirichletPreferences(PreferenceSampler):
    """Preferences from a Dirichlet distribution.

    Args:
        num_objectives: objectives ``n`` that a preference weighs.
        concentration: one value for all objectives or one for each; below 1 draws gather at the corners, above 1 in
            the middle.

    Raises:
        ValueError: if ``concentration`` is not positive or has another length than ``num_objectives``.

    Examples:
        >>> DirichletPreferences(3, concentration=[0.5, 0.5, 2.0])(16).shape
        torch.Size([16, 3])
    """

    def __init__(self, num_objectives: int, concentration: float | Sequence[float] = 0.5) -> None:
        super().__init__(num_objectives)
        self.concentration = torch.as_tensor(concentration, dtype=torch.float32)
        if self.concentration.ndim and self.concentration.shape != (num_objectives,):
            raise ValueError(f"concentration must be a number or {num_objectives} numbers, got {concentration}.")
        if not (self.concentration > 0).all():
            raise ValueError(f"concentration must be positive, got {concentration}.")

    def __call__(
        self, *batch_size: int, device: torch.device | str | None = None, generator: torch.Generator | None = None
    ) -> Tensor:
        """Draws preferences ``[*batch_size, n]``."""
        concentration = self.concentration.to(device).expand(*batch_size, self.num_objectives)
        return torch._sample_dirichlet(concentration, generator=generator)  # torch.distributions takes no generator


class SegmentedPreferences(PreferenceSampler):
    """Each environment explores its own segment of the preference space (Sec. IV-A).

    The simplex is cut across its first coordinate into slices of equal volume, the first slice holding the lowest
    weights of the first objective. Together the slices are the whole simplex, and draws over all segments are uniform.
    For two objectives these are the equal parts of the line; for more, PD-MORL's parts of the lexicographic grid.

    The last batch dimension counts environments: environment ``i`` draws from segment ``(offset + i) % segments``. An
    unbatched draw is environment 0, so unbatched workers each need their own ``offset``.

    Args:
        num_objectives: objectives ``n`` that a preference weighs.
        segments: parts that the simplex is cut into.
        offset: number of the first environment.

    Raises:
        ValueError: if ``segments`` is below 1 or ``offset`` below 0.

    Examples:
        >>> preferences = SegmentedPreferences(2, segments=2)(100, 2)
        >>> bool((preferences[:, 0, 0] <= 0.5).all() and (preferences[:, 1, 0] >= 0.5).all())
        True
    """

    def __init__(self, num_objectives: int, segments: int, offset: int = 0) -> None:
        super().__init__(num_objectives)
        check_at_least(1, segments=segments)
        check_at_least(0, offset=offset)
        self.segments = segments
        self.offset = offset

    def __call__(
        self, *batch_size: int, device: torch.device | str | None = None, generator: torch.Generator | None = None
    ) -> Tensor:
        """Draws preferences ``[*batch_size, n]``; the last batch dimension counts environments."""
        if self.num_objectives == 1:
            return torch.ones(*batch_size, 1, device=device)
        environments = torch.arange(prod(batch_size[-1:]), device=device).reshape(batch_size[-1:])
        segment = (self.offset + environments) % self.segments
        volume = (segment + torch.rand(batch_size, device=device, generator=generator)) / self.segments
        # Below a first coordinate x lies 1 - (1 - x)^(n - 1) of the simplex's volume; this is the inverse.
        first = 1 - (1 - volume).pow(1 / (self.num_objectives - 1)).unsqueeze(-1)
        others = _uniform(batch_size, self.num_objectives - 1, device, generator)
        return torch.cat([first, (1 - first) * others], -1)


class CornerWeightedPreferences(PreferenceSampler):
    """Uniform preferences with a share of draws on the simplex's corners and edges, where uniform ones never fall.

    Args:
        num_objectives: objectives ``n`` that a preference weighs.
        corner: share of draws exactly at a corner.
        edge: share of draws on the edge between two corners.

    Raises:
        ValueError: if a share is negative or both exceed 1 together.

    Examples:
        >>> CornerWeightedPreferences(3, corner=1.0, edge=0.0)(100).amax(-1).min()
        tensor(1.)
    """

    def __init__(self, num_objectives: int, corner: float = 0.5, edge: float = 0.2) -> None:
        super().__init__(num_objectives)
        if not (corner >= 0 and edge >= 0 and corner + edge <= 1):
            raise ValueError(f"corner and edge must be shares that sum to at most 1, got {corner} and {edge}.")
        self.corner = corner
        self.edge = edge

    def __call__(
        self, *batch_size: int, device: torch.device | str | None = None, generator: torch.Generator | None = None
    ) -> Tensor:
        """Draws preferences ``[*batch_size, n]``."""
        n, draw = self.num_objectives, {"device": device, "generator": generator}
        kind = torch.rand(*batch_size, 1, **draw)
        along = torch.rand(*batch_size, 1, **draw).masked_fill(kind < self.corner, 0)
        start = torch.randint(n, (*batch_size, 1), **draw)
        end = (start + torch.randint(1, max(n, 2), (*batch_size, 1), **draw)) % n
        border = torch.zeros(*batch_size, n, device=device).scatter(-1, start, 1 - along).scatter_add(-1, end, along)
        return torch.where(kind < self.corner + self.edge, border, _uniform(batch_size, n, device, generator))


class FixedPreferences(PreferenceSampler):
    """Always the same preference.

    Args:
        value: the preference ``[n]``.
        num_objectives: objectives ``n`` that it has to weigh; as many as it has entries by default.

    Raises:
        ValueError: if ``value`` is not one preference: ``n`` non-negative numbers that sum to 1.

    Examples:
        >>> FixedPreferences([0.5, 0.25, 0.25])(2)
        tensor([[0.5000, 0.2500, 0.2500],
                [0.5000, 0.2500, 0.2500]])
    """

    def __init__(self, value: Sequence[float] | Tensor, num_objectives: int | None = None) -> None:
        preference = torch.as_tensor(value, dtype=torch.float32)
        if preference.ndim != 1 or not ((preference >= 0).all() and abs(preference.sum() - 1) < 1e-4):
            raise ValueError(f"A fixed preference must be non-negative numbers that sum to 1, got {value}.")
        if num_objectives not in (None, len(preference)):
            raise ValueError(
                f"A fixed preference must be one number for each of {num_objectives} objectives, got {value}."
            )
        super().__init__(len(preference))
        self.value = preference / preference.sum()

    def __call__(
        self, *batch_size: int, device: torch.device | str | None = None, generator: torch.Generator | None = None
    ) -> Tensor:
        """Repeats the preference to ``[*batch_size, n]``."""
        return self.value.to(device).repeat(*batch_size, 1)


class GridPreferences(PreferenceSampler):
    """Each preference of :func:`simplex_grid` is equally likely.

    Args:
        num_objectives: objectives ``n`` that a preference weighs.
        steps: equal steps between 0 and 1.
        noise: each weight of a draw is off its grid point by up to so much, uniformly, before negative ones are set to
            0 and all are divided by their sum.

    Raises:
        ValueError: for numbers out of range.

    Examples:
        >>> GridPreferences(3, steps=4)(16).shape
        torch.Size([16, 3])
    """

    def __init__(self, num_objectives: int, steps: int, noise: float = 0.0) -> None:
        super().__init__(num_objectives)
        if not 0 <= noise < 1 / num_objectives:
            raise ValueError(f"noise must be at least 0 and below 1 / num_objectives, got {noise}.")
        self.grid = simplex_grid(num_objectives, steps)
        self.noise = noise

    def __call__(
        self, *batch_size: int, device: torch.device | str | None = None, generator: torch.Generator | None = None
    ) -> Tensor:
        """Draws preferences ``[*batch_size, n]``."""
        rows = torch.randint(len(self.grid), batch_size, device=device, generator=generator)
        drawn = self.grid.to(device)[rows]
        if not self.noise:
            return drawn
        drawn = drawn + self.noise * (2 * torch.rand(drawn.shape, device=device, generator=generator) - 1)
        return normalize(drawn.clamp(min=0), p=1, dim=-1)


def _uniform(
    batch_size: Sequence[int], num_objectives: int, device: torch.device | str | None, generator: torch.Generator | None
) -> Tensor:
    """Uniform on the simplex ``[*batch_size, num_objectives]``: normalised exponentials."""
    lengths = torch.empty(*batch_size, num_objectives, device=device).exponential_(generator=generator)
    return lengths / lengths.sum(-1, keepdim=True)
