"""Quality of a front of return vectors: non-dominated points, hypervolume, expected utility."""

from __future__ import annotations

import numpy as np
from torch import Tensor, nn

from morlnav.objectives.scalarisation import LinearScalarisation


def pareto_mask(points: Tensor) -> Tensor:
    """Which of ``points`` ``[N, m]`` no other point dominates, ``bool`` ``[N]``; larger is better.

    Equal points do not dominate each other, so both are kept.

    Raises:
        ValueError: if ``points`` is not a matrix of numbers.

    Examples:
        >>> import torch
        >>> pareto_mask(torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.0, 0.5]]))
        tensor([ True,  True, False])
    """
    _check_points(points)
    weakly = (points[:, None] >= points[None]).all(-1)
    return ~(weakly & ~weakly.T).any(0)


def hypervolume(points: Tensor, reference: Tensor) -> float:
    """Volume of what ``points`` ``[N, m]`` dominate above ``reference`` ``[m]``; exact, for any number of objectives.

    Larger is better in every objective. The volume depends on the reference point: compare only values with the same
    one, and choose it worse than anything seen. Points that do not exceed it in every objective add nothing. Follows
    the WFG algorithm (While et al., 2012): the sum of what each point adds to those after it, which is fast for
    fronts of up to about a hundred points.

    Raises:
        ValueError: if the shapes do not fit, or a number is not finite.

    Examples:
        >>> import torch
        >>> hypervolume(torch.tensor([[2.0, 1.0], [1.0, 2.0]]), torch.zeros(2))
        3.0
    """
    _check_points(points)
    if reference.shape != points.shape[1:] or not reference.isfinite().all():
        raise ValueError(
            f"The reference point needs {points.shape[1]} finite numbers, one per objective; got {reference.tolist()}."
        )
    gains = (points - reference).double()
    gains = gains[(gains > 0).all(-1)]
    return _volume(gains.cpu().numpy())


def _volume(gains: np.ndarray) -> float:
    """Volume of the union of the boxes between the origin and each row of ``gains`` ``[N, m]``."""
    gains = np.unique(gains, axis=0)
    dominated = (gains[:, None] >= gains[None]).all(-1).sum(0) > 1
    gains = gains[~dominated]
    if gains.shape[1] <= 2:  # sorted by the first objective, the second falls: a staircase
        height = gains[:, -1] if gains.shape[1] == 2 else np.ones(len(gains))
        return float((np.diff(gains[:, 0], prepend=0.0) * height).sum())
    gains = gains[np.argsort(-gains[:, -1])]
    # Each point's box, less the part that the points after it dominate as well.
    return sum(
        float(point.prod()) - _volume(np.minimum(point, gains[k + 1 :])) if k + 1 < len(gains) else float(point.prod())
        for k, point in enumerate(gains)
    )


def expected_utility(returns: Tensor, preferences: Tensor, scalarisation: nn.Module | None = None) -> float:
    """Mean over λ of ``wᵀR(λ)``: what users with these preferences get from the policy conditioned on them.

    Args:
        returns: mean return vector of the policy under each preference, ``[P, m]``, static objectives first.
        preferences: λ, ``[P, n]``, ``n <= m``.
        scalarisation: maps ``(λ, m)`` to weights; by default the paper's ``w = (1, …, 1, λ)`` (Eq. 2).

    Raises:
        ValueError: if the shapes do not fit, or a number is not finite.

    Examples:
        >>> import torch
        >>> expected_utility(torch.tensor([[1.0, 2.0, 0.0], [1.0, 0.0, 4.0]]), torch.eye(2))
        4.0
    """
    _check_points(returns)
    if preferences.dim() != 2 or len(preferences) != len(returns) or preferences.shape[1] > returns.shape[1]:
        raise ValueError(
            f"Preferences need the shape [{len(returns)}, n] with n <= {returns.shape[1]} to fit the returns; "
            f"got {list(preferences.shape)}."
        )
    return float(utility(returns, preferences, scalarisation).mean())


def utility(returns: Tensor, preferences: Tensor, scalarisation: nn.Module | None = None) -> Tensor:
    """Scalarised returns ``wᵀR``: ``[..., m]`` and ``[..., n]`` give ``[...]``.

    The weights are those of ``scalarisation``, by default the paper's ``w = (1, …, 1, λ)`` (Eq. 2).

    >>> import torch
    >>> utility(torch.tensor([1.0, 2.0, 4.0]), torch.tensor([0.5, 0.5]))
    tensor(4.)
    """
    scalarisation = scalarisation if scalarisation is not None else LinearScalarisation()
    return (scalarisation(preferences, returns.shape[-1]) * returns).sum(-1)


def _check_points(points: Tensor) -> None:
    if points.dim() != 2 or not points.numel() or not points.isfinite().all():
        raise ValueError(f"Return vectors need the shape [N, m] and finite numbers, got {list(points.shape)}.")
