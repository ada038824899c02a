"""Bounds of an action, as several losses need them."""

from __future__ import annotations

import torch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec

from morlnav.modules.networks import check_bounds


def action_bounds(
    action_spec: TensorSpec | None, bounds: tuple[Tensor | float, Tensor | float] | None, key: NestedKey = "action"
) -> tuple[Tensor, Tensor]:
    """Least and largest action ``[A]`` from a spec, batched or not, or from given bounds.

    Args:
        action_spec: a ``Bounded`` spec, or a ``Composite`` that holds one under ``key``.
        bounds: ``(low, high)``; exactly one of the two.
        key: of the action.

    Raises:
        ValueError: for missing or contradictory bounds, and as :func:`~morlnav.modules.networks.check_bounds`.

    Examples:
        >>> action_bounds(None, (-1.0, 1.0))
        (tensor(-1.), tensor(1.))
    """
    if (action_spec is None) == (bounds is None):
        raise ValueError("Give exactly one of 'action_spec' and 'bounds'.")
    if bounds is None:
        if isinstance(action_spec, Composite):
            action_spec = action_spec[key]
        if not isinstance(action_spec, Bounded):
            raise ValueError(f"action_spec must be Bounded, got {type(action_spec).__name__}.")
        space = action_spec.space  # all environments of a batch share one action space
        bounds = space.low.reshape(-1, space.low.shape[-1])[0], space.high.reshape(-1, space.high.shape[-1])[0]
    low, high = (torch.as_tensor(bound, dtype=torch.get_default_dtype()).clone() for bound in bounds)
    check_bounds(low, high)
    return low, high
