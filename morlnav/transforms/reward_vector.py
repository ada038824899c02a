"""What the entries of an environment's reward vector are."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torchrl.data import Bounded
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv

from morlnav.transforms.demonstration_reward import DemonstrationReward


@dataclass(frozen=True)
class RewardVector:
    """Names and bounds of the entries of a reward vector, static ones first (Eq. 2).

    An environment may tell ``rewards`` (its entries' names), ``num_static`` and ``reward_bounds`` (``[2, m]``) by
    attributes of these names, as :class:`~morlnav.navigation.envs.NavigationEnv` does. Of any other the entries are
    called ``objective_0`` and so on, all of them are tuneable, and bounds are those of its reward spec.

    Attributes:
        names: of all ``m`` entries.
        num_static: entries in front whose weight is always 1.
        bounds: least and largest reward of a step, ``[2, m]``; infinite where unknown.

    Examples:
        >>> from morlnav import NavigationEnv
        >>> RewardVector.of(NavigationEnv()).objectives
        ('distance', 'efficiency')
    """

    names: tuple[str, ...]
    num_static: int
    bounds: Tensor

    @property
    def objectives(self) -> tuple[str, ...]:
        """Names of the ``n`` tuneable entries, in the order of the preference's."""
        return self.names[self.num_static :]

    @classmethod
    def of(cls, env: EnvBase) -> RewardVector:
        """The reward vector of an environment, with what its transforms add.

        Raises:
            ValueError: if its attributes contradict its reward spec.
        """
        base = env.base_env if isinstance(env, TransformedEnv) else env
        spec = base.reward_spec
        size = spec.shape[-1]
        names = tuple(getattr(base, "rewards", [f"objective_{i}" for i in range(size)]))
        bounds = getattr(base, "reward_bounds", None)
        if bounds is None:
            space = spec.space if isinstance(spec, Bounded) else None
            ends = [torch.full((size,), -torch.inf), torch.full((size,), torch.inf)]
            bounds = torch.stack(
                ends if space is None else [e.reshape(-1, size)[0].cpu() for e in (space.low, space.high)]
            )
        if len(names) != size or bounds.shape != (2, size):
            raise ValueError(
                f"The environment pays {size} rewards, but names {len(names)} and bounds {bounds.shape[-1]}."
            )
        vector = cls(names, getattr(base, "num_static", 0), bounds)
        for transform in transforms_of(env):
            if isinstance(transform, DemonstrationReward) and transform.insert:
                vector = vector._with(transform)
        return vector

    def _with(self, transform: DemonstrationReward) -> RewardVector:
        entry = transform.entry
        names = (*self.names[:entry], transform.name, *self.names[entry:])
        own = torch.tensor(transform.bounds()).unsqueeze(1).to(self.bounds)
        return RewardVector(names, self.num_static, torch.cat([self.bounds[:, :entry], own, self.bounds[:, entry:]], 1))


def transforms_of(env: EnvBase) -> list[Transform]:
    """The transforms of an environment, one by one.

    >>> from morlnav import NavigationEnv
    >>> from torchrl.envs import StepCounter
    >>> len(transforms_of(TransformedEnv(NavigationEnv(), StepCounter())))
    1
    >>> transforms_of(NavigationEnv())
    []
    """
    transform = env.transform if isinstance(env, TransformedEnv) else Compose()
    return list(transform) if isinstance(transform, Compose) else [transform]
