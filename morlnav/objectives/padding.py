"""Padded steps, which may hold anything, even NaN."""

from __future__ import annotations

from collections.abc import Iterable

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor


def blank_padding(tensordict: TensorDictBase, keys: Iterable[NestedKey], mask: Tensor) -> TensorDictBase:
    """The named entries, with zeros in padded steps.

    To leave padding out of the loss alone does not do: a gradient of 0 times NaN is NaN.

    Args:
        tensordict: holds ``keys``, whose shapes begin with that of ``mask``.
        keys: entries to keep.
        mask: true for real steps, such as ``[B, L]``.

    Returns:
        A new tensordict; the given one stays as it is.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> snippet = TensorDict(observation=torch.tensor([[1.0], [torch.nan]]), batch_size=[2])
        >>> blank_padding(snippet, ["observation"], torch.tensor([True, False]))["observation"].tolist()
        [[1.0], [0.0]]
    """
    out = tensordict.select(*keys)
    for key in keys:
        value = out.get(key)
        padded = ~mask.reshape(*mask.shape, *[1] * (value.ndim - mask.ndim))
        out.set(key, value.masked_fill(padded, 0))
    return out
