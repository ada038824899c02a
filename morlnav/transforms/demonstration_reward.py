"""Writes the demonstration entry of the reward vector from a learned reward model."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from numbers import Real

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from morlnav.limits import check_at_least


class DemonstrationReward(Transform):
    """Inserts ``scale·(R̂(s_t, a_t) + offset)`` into the reward vector, or writes it over an entry (Sec. III-D.3).

    With ``R̂`` in [0, 1] and the default offset the entry lies in [-10, 0]. The printed form is ``offset=1.0``.

    It works in an environment and, with ``reward_key=("next", "reward")``, in a replay buffer, where it rewards stored
    transitions anew whenever they are sampled. In an environment it belongs before transforms that read the reward,
    such as ``RewardSum``. The reward model is copied and frozen: it stays in evaluation mode, gets no gradients, and
    later training of the original does not show.

    Args:
        reward_model: ``observation [..., D], action [..., A] -> [...]``.
        scale: the factor ``c_d``.
        offset: added to ``R̂``.
        entry: index that the entry has in the resulting vector.
        name: of the entry: the objective that was demonstrated.
        insert: make room for the entry; ``False`` writes over the one that is there.
        observation_key: entry that holds ``s_t``.
        action_key: entry that holds ``a_t``.
        reward_key: entry that holds the reward vector ``[..., m]``, seen from the root of the buffer's transitions or
            of the environment's step.

    Raises:
        ValueError: if ``scale`` or ``offset`` is not finite, or ``entry`` is negative, or beyond the vector it meets.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from morlnav import NavigationEnv
        >>> slow = lambda observation, action: 1 - action[..., 0] / 0.5
        >>> env = TransformedEnv(NavigationEnv(num_envs=3), DemonstrationReward(slow))
        >>> env.rollout(2)["next", "reward"].shape  # baseline, demo, distance, efficiency
        torch.Size([3, 2, 4])
    """

    def __init__(
        self,
        reward_model: nn.Module | Callable[[Tensor, Tensor], Tensor],
        scale: float = 10.0,
        offset: float = -1.0,
        entry: int = 1,
        name: str = "demo",
        insert: bool = True,
        observation_key: NestedKey = "observation",
        action_key: NestedKey = "action",
        reward_key: NestedKey = "reward",
    ) -> None:
        super().__init__()
        for key, value in {"scale": scale, "offset": offset}.items():
            if not (isinstance(value, Real) and math.isfinite(value)):
                raise ValueError(f"DemonstrationReward needs a finite number as {key}, got {value}.")
        check_at_least(0, entry=entry)
        frozen = isinstance(reward_model, nn.Module)
        self.reward_model = copy.deepcopy(reward_model).eval().requires_grad_(False) if frozen else reward_model
        self.scale = scale
        self.offset = offset
        self.entry = entry
        self.name = name
        self.insert = insert
        self.observation_key = observation_key
        self.action_key = action_key
        self.reward_key = reward_key

    def bounds(self) -> tuple[float, float]:
        """Least and largest reward of a step, for ``R̂`` in [0, 1]."""
        ends = self.scale * self.offset, self.scale * (1 + self.offset)
        return min(ends), max(ends)

    def reward(self, observation: Tensor, action: Tensor) -> Tensor:
        """``scale·(R̂(s, a) + offset)`` for observations ``[..., D]`` and actions ``[..., A]``, ``[...]``."""
        return self.scale * (self.reward_model(observation, action) + self.offset)

    def train(self, mode: bool = True) -> DemonstrationReward:
        """Set the transform's mode; the reward model stays in evaluation mode."""
        super().train(mode)
        if isinstance(self.reward_model, nn.Module):
            self.reward_model.eval()
        return self

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(self.reward_key, self._extend(tensordict, next_tensordict.get(self.reward_key)))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Reward a batch of transitions ``[*B]``, as a replay buffer does on ``sample``."""
        return tensordict.set(self.reward_key, self._extend(tensordict, tensordict.get(self.reward_key)))

    def _extend(self, tensordict: TensorDictBase, reward: Tensor) -> Tensor:
        """The reward vectors ``[..., m]`` with the demonstration's entry, ``[..., m + insert]``."""
        self._check(reward.shape[-1])
        earned = self.reward(tensordict.get(self.observation_key), tensordict.get(self.action_key))
        demonstration = earned.unsqueeze(-1).to(reward.dtype)
        after = self.entry if self.insert else self.entry + 1
        return torch.cat([reward[..., : self.entry], demonstration, reward[..., after:]], -1)

    def _check(self, num_objectives: int) -> None:
        if self.entry >= num_objectives + self.insert:
            what = "inserted into" if self.insert else "written over in"
            raise ValueError(f"Entry {self.entry} cannot be {what} a reward vector of {num_objectives}.")

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        """The spec of the longer reward vector; unbounded, since a reward model may be anything."""
        spec = reward_spec[self.reward_key]
        self._check(spec.shape[-1])
        shape = (*spec.shape[:-1], spec.shape[-1] + self.insert)
        reward_spec[self.reward_key] = Unbounded(shape=shape, device=spec.device, dtype=spec.dtype)
        return reward_spec

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}(scale={self.scale}, offset={self.offset}, entry={self.entry}, "
            f"insert={self.insert}, reward_key={self.reward_key!r})"
        )
