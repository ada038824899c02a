"""Another driver of some episodes, from whose way an actor learns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import torch
from torch import Tensor, nn

Policy = Callable[[Tensor, Tensor], Tensor]
"""Maps observations ``[..., D]`` and preferences ``[..., n]`` to actions ``[..., A]``."""


class Rival(ABC):
    """Another driver of some episodes, such as a policy's own mirror image.

    A policy that has found one of several ways, such as a side to pass on, drives it ever after, so that what is
    collected, and with it the critics, knows no other. A rival shows others.

    Args:
        share: of the environments that it drives while frames are collected, in [0, 1], spread evenly.

    Raises:
        ValueError: if ``share`` is none.

    Examples:
        >>> class Backward(Rival):
        ...     def __call__(self, policy, observation, preference):
        ...         return -policy(observation, preference)
        >>> forward = lambda observation, preference: torch.ones(*observation.shape[:-1], 1)
        >>> Backward(share=0.25).beside(forward)(torch.zeros(8, 3), torch.zeros(8, 2)).flatten()
        tensor([ 1.,  1.,  1., -1.,  1.,  1.,  1., -1.])
    """

    def __init__(self, share: float = 0.25) -> None:
        if not 0 <= share <= 1:
            raise ValueError(f"share must be between 0 and 1, got {share}.")
        self.share = share

    @abstractmethod
    def __call__(self, policy: Policy, observation: Tensor, preference: Tensor) -> Tensor:
        """Actions ``[..., A]`` of a policy's rival, for observations ``[..., D]`` and preferences ``[..., n]``."""

    def beside(self, policy: Policy) -> nn.Module:
        """The policy in most environments of a batch, its rival in the others."""
        return _Beside(policy, self)


class _Beside(nn.Module):
    def __init__(self, policy: Policy, rival: Rival) -> None:
        super().__init__()
        self.policy, self.rival = policy, rival

    def forward(self, observation: Tensor, preference: Tensor) -> Tensor:
        action = self.policy(observation, preference)
        if observation.ndim < 2:  # a single environment
            return action
        mine = spread(self.rival.share, observation.shape[-2], observation.device).unsqueeze(-1)
        return torch.where(mine, self.rival(self.policy, observation, preference), action)


def spread(share: float, count: int, device: torch.device | None = None) -> Tensor:
    """Which of ``count`` environments belong to a share of them, evenly spread, ``bool`` ``[count]``.

    >>> spread(0.5, 4)
    tensor([False,  True, False,  True])
    """
    return (share * torch.arange(count + 1, device=device)).floor().diff().bool()
