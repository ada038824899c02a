"""Hindsight relabelling: sampled transitions are given fresh preferences."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, expand_right
from torchrl.envs import Transform

from morlnav.data.preferences import PreferenceSampler
from morlnav.limits import check_at_least


class HindsightPreferenceRelabel(Transform):
    """Replay-buffer transform: redraws λ for a random share of the sampled transitions.

    The reward vector of a transition does not depend on λ, so a transition teaches about every preference. PD-MORL
    stores it once with its own λ and three times with random ones; here it is stored once and relabelled whenever it is
    sampled, which with ``share=0.75`` is the same distribution at a quarter of the memory.

    With ``num_relabels=k`` above 1 each sampled transition is returned ``k`` times, as a batch ``[B, k]``, and each
    copy is relabelled with probability ``share`` on its own. The buffer's ``index`` and ``priority_weight`` are
    repeated along, and priorities are reduced over a transition's copies.

    Only ``forward`` does anything, which runs on ``sample``: storing data and stepping an environment are unaffected.

    Args:
        sampler: draws the fresh preferences ``[*B, n]``.
        share: probability of redrawing a transition's λ.
        num_relabels: copies ``k`` of each sampled transition.
        preference_key: entry that holds λ.
        next_key: entry that holds λ of the next state; it is given the same value.

    Raises:
        ValueError: if ``share`` is not in [0, 1] or ``num_relabels`` is below 1.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        >>> from morlnav.data.preferences import UniformPreferences
        >>> relabel = HindsightPreferenceRelabel(UniformPreferences(3), share=0.75)
        >>> buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(100), transform=relabel, batch_size=32)
        >>> own = torch.eye(3)[torch.zeros(100, dtype=torch.long)]
        >>> _ = buffer.extend(TensorDict({"preference": own, "next": {"preference": own}}, [100]))
        >>> batch = buffer.sample()
        >>> bool((batch["preference"] == batch["next", "preference"]).all())
        True
    """

    def __init__(
        self,
        sampler: PreferenceSampler,
        share: float = 1.0,
        num_relabels: int = 1,
        preference_key: NestedKey = "preference",
        next_key: NestedKey = ("next", "preference"),
    ) -> None:
        super().__init__()
        if not 0 <= share <= 1:
            raise ValueError(f"share must be between 0 and 1, got {share}.")
        check_at_least(1, num_relabels=num_relabels)
        self.sampler = sampler
        self.share = share
        self.num_relabels = num_relabels
        self.preference_key = preference_key
        self.next_key = next_key

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Relabels a sampled batch ``[*B]``; returns it as ``[*B]``, or ``[*B, k]`` for ``num_relabels = k > 1``."""
        if self.num_relabels > 1:
            tensordict = torch.stack([tensordict] * self.num_relabels, tensordict.ndim)
        own = tensordict.get(self.preference_key)
        fresh = self.sampler(tensordict.numel(), device=own.device).to(own.dtype).reshape(own.shape)
        redraw = torch.rand(tensordict.batch_size, device=own.device) < self.share
        preference = torch.where(expand_right(redraw, own.shape), fresh, own)
        return tensordict.set(self.preference_key, preference).set(self.next_key, preference)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}(sampler={self.sampler}, share={self.share}, num_relabels={self.num_relabels}, "
            f"preference_key={self.preference_key!r}, next_key={self.next_key!r})"
        )
