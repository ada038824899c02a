"""Bounds of an action, as several losses need them, and of a return."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import Bounded, Composite, TensorSpec

from morlnav.modules.networks import check_bounds


class ReturnBounds(nn.Module):
    """Keeps values within what bounded rewards can add up to (Andrychowicz et al. 2017, for every entry of a reward).

    An episode may end at any time, so returns lie in ``[min(low, 0), max(high, 0)] / (1 - γ)``.

    Args:
        reward_bounds: least and largest reward of a step, ``[2, m]`` or two numbers; infinite where unknown.

    Raises:
        ValueError: if a least reward is above the largest.

    Examples:
        >>> bounds = ReturnBounds([[-1.0, -1.0], [0.0, torch.inf]])
        >>> bounds(torch.tensor([[0.5, 50.0], [-20.0, -20.0]]), torch.tensor(0.9))
        tensor([[  0.0000,  50.0000],
                [-10.0000, -10.0000]])
    """

    def __init__(self, reward_bounds: Tensor | Sequence[Sequence[float]] | tuple[float, float]) -> None:
        super().__init__()
        low, high = (torch.as_tensor(bound, dtype=torch.float32) for bound in reward_bounds)
        if (low > high).any():
            raise ValueError(f"reward_bounds must be (low, high) with low <= high, got {reward_bounds}.")
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("high", high, persistent=False)

    def forward(self, value: Tensor, gamma: Tensor) -> Tensor:
        """Values ``[..., m]``, clamped, for discounts ``[m]`` or one."""
        ends = (end / (1 - gamma) for end in (self.low.clamp_max(0), self.high.clamp_min(0)))
        return value.clamp(*(end.nan_to_num(0.0, torch.inf, -torch.inf) for end in ends))  # 0 / 0 without a discount


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
