"""How a preference weighs the entries of a reward or value vector."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn


class LinearScalarisation(nn.Module):
    """Weights ``[1, …, 1, λ]``: objectives beyond the preference's entries are static, with a fixed weight (Eq. 2).

    Args:
        static: weight of the static objectives. Above 1, what must hold under every preference, such as driving without
            a collision, counts for more against it; 1 is the paper's form.
        tie_break: added to every preference entry, or one number for each ``[n]``. A small positive value makes the
            scalarised optimum unique where a preference of zero would leave an objective free (augmented weighted
            sum); 0 is the paper's form.

    Raises:
        ValueError: if ``static`` is not positive, or ``tie_break`` is negative or of another length than preferences.

    Examples:
        >>> LinearScalarisation()(torch.tensor([0.25, 0.75]), 3)
        tensor([1.0000, 0.2500, 0.7500])
        >>> LinearScalarisation(tie_break=[0.0, 0.25])(torch.tensor([1.0, 0.0]), 3)
        tensor([1.0000, 1.0000, 0.2500])
        >>> LinearScalarisation(static=2.0)(torch.tensor([0.25, 0.75]), 3)
        tensor([2.0000, 0.2500, 0.7500])
    """

    tie_break: Tensor

    def __init__(self, static: float = 1.0, tie_break: float | Sequence[float] = 0.0) -> None:
        super().__init__()
        if static <= 0:
            raise ValueError(f"The weight of static objectives must be positive, got {static}.")
        self.static = static
        self.register_buffer("tie_break", torch.as_tensor(tie_break, dtype=torch.float32), persistent=False)
        if (self.tie_break < 0).any():
            raise ValueError(f"tie_break must not be negative, got {tie_break}.")

    def forward(self, preference: Tensor, num_objectives: int) -> Tensor:
        """Weights ``[..., m]`` for preferences ``[..., n]``, ``n <= m = num_objectives``.

        Raises:
            ValueError: if there are more preference entries than objectives.
        """
        num_static = num_objectives - preference.shape[-1]
        if num_static < 0:
            raise ValueError(
                f"A preference of {preference.shape[-1]} entries cannot weigh {num_objectives} objectives."
            )
        if self.tie_break.ndim and len(self.tie_break) != preference.shape[-1]:
            raise ValueError(
                f"{len(self.tie_break)} tie_breaks cannot serve {preference.shape[-1]} preference entries."
            )
        static = preference.new_full((*preference.shape[:-1], num_static), self.static)
        return torch.cat([static, preference + self.tie_break], -1)
