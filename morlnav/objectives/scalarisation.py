"""How a preference weighs the entries of a reward or value vector."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class LinearScalarisation(nn.Module):
    """Weights ``[1, …, 1, λ]``: objectives beyond the preference's entries are static, with weight one (Eq. 2).

    Args:
        tie_break: added to every preference entry. A small positive value makes the scalarised optimum unique where
            a preference of zero would leave an objective free (augmented weighted sum); 0 is the paper's form.

    Examples:
        >>> LinearScalarisation()(torch.tensor([0.25, 0.75]), 3)
        tensor([1.0000, 0.2500, 0.7500])
    """

    def __init__(self, tie_break: float = 0.0) -> None:
        super().__init__()
        if tie_break < 0:
            raise ValueError(f"tie_break must not be negative, got {tie_break}.")
        self.tie_break = tie_break

    def forward(self, preference: Tensor, num_objectives: int) -> Tensor:
        """Weights ``[..., m]`` for preferences ``[..., n]``, ``n <= m = num_objectives``.

        Raises:
            ValueError: if there are more preference entries than objectives.
        """
        static = num_objectives - preference.shape[-1]
        if static < 0:
            raise ValueError(
                f"A preference of {preference.shape[-1]} entries cannot weigh {num_objectives} objectives."
            )
        ones = preference.new_ones(*preference.shape[:-1], static)
        return torch.cat([ones, preference + self.tie_break], -1)
