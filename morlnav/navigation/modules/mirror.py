"""The other side of everything: what a driver would do in the mirror image of what it sees."""

from __future__ import annotations

import torch
from torch import Tensor

from morlnav.modules.rival import Policy, Rival


class MirrorImage(Rival):
    """The mirror image of a driver, who passes on the left what the driver passes on the right.

    Robot and sensors are symmetric: what the driver would do in the mirrored scene, mirrored, is as good a drive in the
    scene itself, as far as no reward asks for a side.

    Args:
        observe_human: whether observations hold the human's distance and bearing.
        sectors: number of lidar sectors, the first of which begins straight ahead.
        share: of the environments that it drives while frames are collected.

    Examples:
        >>> def to_the_goal(observation, preference):
        ...     return torch.cat([torch.full_like(observation[..., :1], 0.5), observation[..., 1:2]], -1)
        >>> observation, preference = torch.rand(4, 34), torch.rand(4, 2)
        >>> mirrored = MirrorImage()(to_the_goal, observation, preference)
        >>> torch.equal(mirrored, to_the_goal(observation, preference))  # who knows no side has none
        True
    """

    def __init__(self, observe_human: bool = True, sectors: int = 30, share: float = 0.25) -> None:
        super().__init__(share)
        self.sign = torch.tensor([1.0, -1.0] * (1 + observe_human) + [1.0] * sectors)
        self.sectors = sectors

    def __call__(self, policy: Policy, observation: Tensor, preference: Tensor) -> Tensor:
        """Actions ``[..., 2]`` of a policy's mirror image.

        Args:
            policy: maps observations and preferences to actions.
            observation: ``[..., D]``, in raw units.
            preference: ``[..., n]``.
        """
        seen = observation * self.sign.to(observation.device)
        seen = torch.cat([seen[..., : -self.sectors], seen[..., -self.sectors :].flip(-1)], -1)
        action = policy(seen, preference)
        return torch.stack([action[..., 0], -action[..., 1]], -1)
