"""What is refused: values that are not finite, or out of range."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn


def require(condition: Tensor, sentence: str, found: Callable[[], str]) -> None:
    """Refuse what does not meet a condition, without waiting for a GPU.

    Args:
        condition: one ``bool``.
        sentence: what is expected; all that an assertion on a GPU says.
        found: what came instead; called on failure.

    Raises:
        ValueError: with both; on a GPU PyTorch's own error follows at the next synchronisation.

    Examples:
        >>> require(torch.tensor(False), "Distances must be finite", lambda: "nan")
        Traceback (most recent call last):
        ValueError: Distances must be finite, got nan.
    """
    if condition.device.type in ("cuda", "meta"):
        torch._assert_async(condition, sentence)
    elif not condition:
        raise ValueError(f"{sentence}, got {found()}.")


def check_weights(model: nn.Module, name: str) -> None:
    """Refuse a model that learning has ruined. Buffers may hold infinities, as masks do, but no NaN.

    Args:
        model: any module.
        name: what the error calls it, such as the path of its file.

    Raises:
        ValueError: naming the first parameter that is not finite, or buffer that is NaN.

    Examples:
        >>> layer = nn.Linear(2, 1)
        >>> check_weights(layer, "policy.pt")
        >>> _ = nn.init.constant_(layer.bias, float("inf"))
        >>> check_weights(layer, "policy.pt")
        Traceback (most recent call last):
        ValueError: policy.pt cannot be used: its bias is not finite, as after a learning that diverged; train it again.
    """
    ruined = [key for key, value in model.named_parameters() if not value.isfinite().all()]
    ruined += [key for key, value in model.named_buffers() if value.isnan().any()]
    if ruined:
        raise ValueError(
            f"{name} cannot be used: its {ruined[0]} is not finite, as after a learning that diverged; train it again."
        )
