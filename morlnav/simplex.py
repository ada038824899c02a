"""Exact grids of preferences on the simplex."""

from __future__ import annotations

from itertools import chain, combinations
from math import comb

import numpy as np
import torch
from torch import Tensor

from morlnav.limits import check_at_least


def simplex_grid(num_objectives: int, steps: int) -> Tensor:
    """All preferences whose entries are multiples of ``1 / steps``, in lexicographic order.

    The grid is counted in integers ("stars and bars"), so no row is lost or doubled by rounding, and only the rows
    that are returned are ever held in memory.

    Args:
        num_objectives: objectives ``n`` that a preference weighs.
        steps: equal steps between 0 and 1.

    Returns:
        Preferences ``[C(steps + n - 1, n - 1), n]``.

    Raises:
        ValueError: if either number is below 1.

    Examples:
        >>> simplex_grid(3, 10).shape
        torch.Size([66, 3])
        >>> simplex_grid(2, 2)
        tensor([[0.0000, 1.0000],
                [0.5000, 0.5000],
                [1.0000, 0.0000]])
    """
    check_at_least(1, num_objectives=num_objectives, steps=steps)
    slots, bars = steps + num_objectives - 1, num_objectives - 1
    rows = comb(slots, bars)
    positions = np.fromiter(chain.from_iterable(combinations(range(slots), bars)), np.int64, rows * bars)
    fenced = np.pad(positions.reshape(rows, bars), ((0, 0), (1, 1)), constant_values=((0, 0), (-1, slots)))
    return torch.from_numpy(np.diff(fenced) - 1) / steps


def preference_edges(num_objectives: int, steps: int) -> Tensor:
    """The test preferences Λ (Sec. IV-B): interpolations between each two corners of the simplex.

    Args:
        num_objectives: objectives ``n`` that a preference weighs.
        steps: equal steps from one corner to the next.

    Returns:
        Distinct preferences ``[n + C(n, 2) * (steps - 1), n]``, pair by pair, each from its first corner to its second.
        A single objective has but one preference.

    Raises:
        ValueError: if either number is below 1.

    Examples:
        >>> preference_edges(3, 10).shape
        torch.Size([30, 3])
        >>> preference_edges(2, 2)
        tensor([[1.0000, 0.0000],
                [0.5000, 0.5000],
                [0.0000, 1.0000]])
    """
    check_at_least(1, num_objectives=num_objectives, steps=steps)
    if num_objectives == 1:
        return torch.ones(1, 1)
    corners = np.eye(num_objectives, dtype=np.int64)
    walks = (
        (steps - step) * corners[first] + step * corners[second]
        for first, second in combinations(range(num_objectives), 2)
        for step in range(steps + 1)
    )
    return torch.tensor(list(dict.fromkeys(tuple(walk.tolist()) for walk in walks))) / steps
