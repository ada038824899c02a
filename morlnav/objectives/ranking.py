"""The ranking loss of D-REX: Bradley-Terry on pairs of snippets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase, TensorDictParams, unravel_key
from tensordict.nn import TensorDictModule, dispatch
from tensordict.utils import NestedKey, expand_as_right
from torch import Tensor, nn
from torch.nn.functional import softplus
from torchrl.objectives.common import LossModule

from morlnav.limits import check_positive

AGGREGATES = ("mean", "sum")


class RankingLoss(LossModule):
    """Binary cross-entropy of "the better snippet has the larger reward" (Sec. III-C).

    With the reward ``R̂`` of each step, gathered over a snippet by mean or sum, and the temperature ``β``::

        L = -log σ(β·(agg R̂(better) - agg R̂(worse)))

    The mean over equal snippets with ``β = 10`` is the default. The paper's literal form,
    ``aggregate="sum", temperature=1.0`` over whole trajectories, ties the comparison to their length.

    Input is batched ``[B]`` and holds two nested entries, ``better`` and ``worse``, each with what the reward network
    reads, vectors such as ``observation`` ``[B, L, 34]`` and ``action`` ``[B, L, 2]``, and optionally ``mask``
    ``[B, L]`` (or ``[B, L, 1]``), true for real steps and false for padding, which may hold anything. The two
    may differ in length.

    An ensemble is given as a list of networks, which need not be alike. A batch ``[B]`` shows every member the same
    snippets, a batch ``[K, B]`` shows member ``k`` its own row. Losses are summed over members, so each learns as it
    would alone.

    Args:
        reward_network: writes ``reward`` ``[B, L]`` (or ``[B, L, 1]``); or a list of ``K`` such networks.
        aggregate: ``"mean"`` or ``"sum"`` over a snippet's steps.
        temperature: the factor ``β``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"`` over the pairs.

    Raises:
        ValueError: for an unknown ``aggregate``, a temperature that is not positive, or no network.

    Examples:
        >>> from morlnav.modules import RewardModel
        >>> model = RewardModel(["observation", "action"], [0.0, -3.14], [0.5, 3.14], features=34)
        >>> network = TensorDictModule(model, ["observation", "action"], ["reward"])
        >>> loss = RankingLoss(network)
        >>> def snippets():
        ...     return TensorDict(observation=torch.rand(8, 25, 34), action=torch.rand(8, 25, 2), batch_size=[8])
        >>> out = loss(TensorDict(better=snippets(), worse=snippets(), batch_size=[8]))
        >>> out["loss_ranking"].shape, out["accuracy"].shape
        (torch.Size([]), torch.Size([]))
    """

    @dataclass
    class _AcceptedKeys:
        """Configurable keys; ``reward`` and ``mask`` lie within the two snippets."""

        better: NestedKey = "better"
        worse: NestedKey = "worse"
        reward: NestedKey = "reward"
        mask: NestedKey = "mask"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys
    out_keys = ["loss_ranking", "accuracy"]  # noqa: RUF012  (the class attribute TorchRL defines)

    reward_network: nn.ModuleList
    reward_network_params: TensorDictParams
    target_reward_network_params: TensorDictParams

    def __init__(
        self,
        reward_network: TensorDictModule | Sequence[TensorDictModule],
        *,
        aggregate: str = "mean",
        temperature: float = 10.0,
        reduction: str | None = None,
    ) -> None:
        super().__init__()
        if aggregate not in AGGREGATES:
            raise ValueError(f"aggregate must be one of {', '.join(AGGREGATES)}, got {aggregate}.")
        check_positive(temperature=temperature)
        self.is_ensemble = not isinstance(reward_network, TensorDictModule)
        members = nn.ModuleList(reward_network if self.is_ensemble else [reward_network])
        if not len(members):
            raise ValueError("The ranking loss needs at least one reward network.")
        self.aggregate = aggregate
        self.temperature = temperature
        self.reduction = reduction or "mean"
        self.convert_to_functional(members, "reward_network")

    @property
    def in_keys(self) -> list[NestedKey]:
        """Entries that :meth:`forward` needs; masks are read where present."""
        keys = dict.fromkeys(key for member in self.reward_network for key in member.in_keys)
        snippets = self.tensor_keys.better, self.tensor_keys.worse
        return [unravel_key((snippet, key)) for snippet in snippets for key in keys]

    @dispatch(auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """``loss_ranking``, and ``accuracy``: the share of pairs in the right order, ``[K]`` for an ensemble.

        Raises:
            ValueError: if a batch ``[K, B]`` has not one row per member.
        """
        logits = self.logits(tensordict)
        accuracy = (logits.detach() > 0).float().flatten(1).mean(1)
        return TensorDict(
            loss_ranking=self._reduce_loss(softplus(-logits).sum(0)),
            accuracy=accuracy if self.is_ensemble else accuracy.squeeze(0),
        )

    def logits(self, tensordict: TensorDictBase) -> Tensor:
        """The log-odds that every member gives the better snippet, ``[K, B]``."""
        with self.reward_network_params.to_module(self.reward_network, preserve_module_state=False):
            pairs = zip(self.reward_network, self._rows(tensordict), strict=True)
            return self.temperature * torch.stack(
                [
                    self._aggregate(member, row, self.tensor_keys.better)
                    - self._aggregate(member, row, self.tensor_keys.worse)
                    for member, row in pairs
                ]
            )

    def _rows(self, tensordict: TensorDictBase) -> Sequence[TensorDictBase]:
        count = len(self.reward_network)
        if not self.is_ensemble or tensordict.ndim < 2:
            return [tensordict] * count
        if len(tensordict) != count:
            raise ValueError(f"A batch [K, B] needs one row for each of the {count} members, got {len(tensordict)}.")
        return tensordict.unbind(0)

    def _aggregate(self, member: TensorDictModule, row: TensorDictBase, key: NestedKey) -> Tensor:
        """Mean or sum of the reward over the real steps of a snippet, ``[B]``."""
        snippet = row.get(key)
        steps = snippet.get(member.in_keys[0]).ndim - 1
        mask = snippet.get(self.tensor_keys.mask, None)
        inputs = snippet.select(*member.in_keys)
        if mask is not None:  # padding may hold anything, and a gradient of 0 times NaN is NaN
            mask = mask.squeeze(-1) if mask.ndim > steps else mask
            inputs = inputs.apply(lambda entry: entry.masked_fill(~expand_as_right(mask, entry), 0))
        reward = member(inputs).get(self.tensor_keys.reward)
        reward = reward.squeeze(-1) if reward.ndim > steps else reward
        if mask is None:
            return reward.mean(-1) if self.aggregate == "mean" else reward.sum(-1)
        total = torch.where(mask, reward, 0.0).sum(-1)
        return total / mask.sum(-1).clamp_min(1) if self.aggregate == "mean" else total
