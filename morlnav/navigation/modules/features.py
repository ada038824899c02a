"""What networks see of a raw observation."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn

from morlnav.limits import check_at_least


class NavigationFeatures(nn.Module):
    """Bring a raw observation ``[..., 34]`` to numbers of order one, by default ``[..., 68]``.

    Bearings become sine and cosine, so that straight behind is no jump; distances are given linearly and by a term
    that resolves the last decimetres, where contact is decided.

    Args:
        observe_human: whether the observation holds the human's distance and bearing.
        lidar_range: range of the lidar in metres.
        sectors: number of lidar sectors.
        use_lidar: whether the lidar is looked at.
        octaves: Fourier features of the distances to goal and human with this many wavelengths, 16 m, 8 m, ...
            (Tancik et al., NeurIPS 2020). An MLP on the bare distance learns its fine structure late.

    Raises:
        ValueError: for a negative number of octaves.

    Examples:
        >>> NavigationFeatures()(torch.zeros(5, 34)).shape
        torch.Size([5, 68])
        >>> NavigationFeatures(use_lidar=False, octaves=4)(torch.zeros(5, 34)).shape
        torch.Size([5, 24])
    """

    furthest = 1000.0
    """Metres beyond which no goal and no human is."""
    longest = 16.0
    """Longest wavelength of the Fourier features in metres."""

    def __init__(
        self,
        observe_human: bool = True,
        lidar_range: float = 4.0,
        sectors: int = 30,
        use_lidar: bool = True,
        octaves: int = 0,
    ) -> None:
        super().__init__()
        check_at_least(0, octaves=octaves)
        self.observe_human = observe_human
        self.lidar_range = lidar_range
        self.sectors = sectors
        self.use_lidar = use_lidar
        self.octaves = octaves
        self.in_features = 2 + 2 * observe_human + sectors
        self.out_features = (4 + 2 * octaves) * (1 + observe_human) + 2 * sectors * use_lidar

    def config(self) -> dict[str, Any]:
        """The constructor's arguments, as plain values."""
        return {
            name: getattr(self, name) for name in ("observe_human", "lidar_range", "sectors", "use_lidar", "octaves")
        }

    def bounds(self) -> tuple[Tensor, Tensor]:
        """Least and largest entries of an observation ``[D]`` that can be measured; policies refuse others.

        >>> low, high = NavigationFeatures().bounds()
        >>> low[:5].round(decimals=2).tolist(), high[[0, 4]].tolist()
        ([0.0, -3.140000104904175, 0.0, -3.140000104904175, 0.0], [1000.0, 4.0])
        """
        seen = 1 + self.observe_human
        low = torch.tensor([*(0.0, -math.pi) * seen, *[0.0] * self.sectors])
        return low, torch.tensor([*(self.furthest, math.pi) * seen, *[self.lidar_range] * self.sectors])

    def forward(self, observation: Tensor) -> Tensor:
        """Map observations in metres and radians to features.

        Raises:
            ValueError: if the last dimension does not fit.
        """
        if observation.shape[-1] != self.in_features:
            raise ValueError(f"Expected observations [..., {self.in_features}], got {tuple(observation.shape)}.")
        known = 2 * (1 + self.observe_human)
        distance, bearing = observation[..., :known].unflatten(-1, (-1, 2)).unbind(-1)
        shares = distance * torch.exp2(torch.arange(distance.shape[-1], device=distance.device)) / 6 - 1  # 6 m and 3 m
        features = [torch.stack([shares, (-distance).exp(), bearing.sin(), bearing.cos()], -1)]
        if self.octaves:
            frequencies = torch.exp2(torch.arange(self.octaves, device=distance.device)) * (2 * math.pi / self.longest)
            phase = distance.unsqueeze(-1) * frequencies
            features += [phase.sin(), phase.cos()]
        features = torch.cat(features, -1).flatten(-2)
        if not self.use_lidar:
            return features
        lidar = observation[..., known:]
        return torch.cat([features, 1 - 2 * lidar / self.lidar_range, nearness(lidar)], -1)


def nearness(distance: Tensor) -> Tensor:
    """A number that resolves the last decimetres of a distance in metres: 2.7 at contact, 0 at 0.9 m."""
    return 0.3 / (distance + 0.1) - 0.3
