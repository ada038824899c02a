"""Quality of a front of return vectors: non-dominated points, hypervolume, expected utility."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import moocore
import torch
from torch import Tensor

from morlnav.modules.scalarisation import LinearScalarisation


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
    kept = moocore.is_nondominated(points.detach().cpu().double().numpy(), maximise=True, keep_weakly=True)
    return torch.from_numpy(kept).to(points.device)


def hypervolume(points: Tensor, reference: Tensor) -> float:
    """Volume of what ``points`` ``[N, m]`` dominate above ``reference`` ``[m]``; exact, for any number of objectives.

    Larger is better in every objective. The volume depends on the reference point: compare only values with the same
    one, and choose it worse than anything that can happen, as :func:`~morlnav.evaluation.reference_from_bounds` does.
    Points that do not exceed it in every objective add nothing.

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
    above = points.detach()[(points > reference).all(-1)].cpu().double()
    return float(moocore.hypervolume(above.numpy(), ref=reference.cpu().double().numpy(), maximise=True))


Scalarisation: TypeAlias = "Callable[[Tensor, int], Tensor]"
"""Preferences ``[..., n]`` and the number ``m`` of objectives to weights ``[..., m]``, as in a loss."""


def expected_utility(returns: Tensor, preferences: Tensor, scalarisation: Scalarisation | None = None) -> float:
    """Mean over λ of ``wᵀR(λ)``: what users with these preferences get from the policy conditioned on them.

    Args:
        returns: mean return vector of the policy under each preference, ``[P, m]``, static objectives first.
        preferences: λ, ``[P, n]``, ``n <= m``.
        scalarisation: gives the weights ``w``, such as a loss's; ``(1, …, 1, λ)`` (Eq. 2) if ``None``.

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


def utility(returns: Tensor, preferences: Tensor, scalarisation: Scalarisation | None = None) -> Tensor:
    """Scalarised returns ``wᵀR``, by default with ``w = (1, …, 1, λ)`` (Eq. 2): ``[..., m]`` to ``[...]``.

    >>> import torch
    >>> utility(torch.tensor([1.0, 2.0, 4.0]), torch.tensor([0.5, 0.5]))
    tensor(4.)
    """
    scalarisation = scalarisation if scalarisation is not None else LinearScalarisation()
    return (scalarisation(preferences, returns.shape[-1]) * returns).sum(-1)


def _check_points(points: Tensor) -> None:
    if points.dim() != 2 or not points.numel() or not points.isfinite().all():
        raise ValueError(f"Return vectors need the shape [N, m] and finite numbers, got {list(points.shape)}.")
