"""How a preference weighs the entries of a reward or value vector."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn


class LinearScalarisation(nn.Module):
    """Weights ``[1, …, 1, c λ]``: objectives beyond the preference's entries are static, with weight one (Eq. 2).

    Args:
        scale: ``c``, of every preference entry, or one number for each ``[n]``. Below 1, a style counts for less
            against the static objectives: driving without a collision must pay under every preference. 1 is the
            paper's form.
        tie_break: added to every scaled entry, or one number for each ``[n]``. A small positive value makes the
            scalarised optimum unique where a preference of zero would leave an objective free (augmented weighted
            sum); 0 is the paper's form.
        objectives: names of the preference's entries; where they are given, scale and tie break may be mappings from
            them, in which ``default`` serves those that are not named.

    Raises:
        ValueError: if a scale or a tie break is negative, or a mapping does not fit the objectives.

    Examples:
        >>> LinearScalarisation()(torch.tensor([0.25, 0.75]), 3)
        tensor([1.0000, 0.2500, 0.7500])
        >>> LinearScalarisation(scale=[0.5, 1.0], tie_break=[0.0, 0.25])(torch.tensor([1.0, 0.0]), 3)
        tensor([1.0000, 0.5000, 0.2500])
        >>> LinearScalarisation({"default": 1.0, "fast": 0.5}, objectives=["fast", "safe"]).scale
        tensor([0.5000, 1.0000])
    """

    scale: Tensor
    tie_break: Tensor

    def __init__(
        self,
        scale: float | Sequence[float] | Mapping[str, float] = 1.0,
        tie_break: float | Sequence[float] | Mapping[str, float] = 0.0,
        objectives: Sequence[str] = (),
    ) -> None:
        super().__init__()
        for name, value in (("scale", scale), ("tie_break", tie_break)):
            value = torch.as_tensor(by_name(value, objectives, name), dtype=torch.float32)
            self.register_buffer(name, value, persistent=False)
        if (self.scale < 0).any():
            raise ValueError(f"scale must not be negative, got {scale}.")
        if (self.tie_break < 0).any():
            raise ValueError(f"tie_break must not be negative, got {tie_break}.")

    def forward(self, preference: Tensor, num_objectives: int) -> Tensor:
        """Weights ``[..., m]`` for preferences ``[..., n]``, ``n <= m = num_objectives``.

        Raises:
            ValueError: if there are more preference entries than objectives, or another number than of scales or tie
                breaks.
        """
        static = num_objectives - preference.shape[-1]
        if static < 0:
            raise ValueError(
                f"A preference of {preference.shape[-1]} entries cannot weigh {num_objectives} objectives."
            )
        for name, value in self.named_buffers():
            if value.ndim and len(value) != preference.shape[-1]:
                raise ValueError(f"{name} has {len(value)} entries, the preference {preference.shape[-1]}.")
        ones = preference.new_ones(*preference.shape[:-1], static)
        return torch.cat([ones, self.scale * preference + self.tie_break], -1)


def by_name(
    value: float | Sequence[float] | Mapping[str, float], names: Sequence[str], key: str
) -> float | list[float]:
    """A number, or one for each of ``names``; from a mapping, ``default`` serves the names that it lacks.

    Raises:
        ValueError: for a name that is none of ``names``, or one without a value.

    Examples:
        >>> by_name({"default": 1.0, "safe": 2.0}, ["fast", "safe"], "scale"), by_name(3, [], "scale")
        ([1.0, 2.0], 3.0)
    """
    if not isinstance(value, Mapping):
        return float(value) if isinstance(value, int | float) else list(value)
    if foreign := [name for name in value if name not in (*names, "default")]:
        raise ValueError(f"{key} names {foreign[0]}, which is none of: {', '.join((*names, 'default'))}.")
    missing = [name for name in names if name not in value and "default" not in value]
    if missing:
        raise ValueError(f"{key} names no value for {', '.join(missing)}, and no default.")
    return [float(value.get(name, value.get("default"))) for name in names]
