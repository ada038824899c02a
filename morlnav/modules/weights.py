"""Weights that are worth keeping: finite ones."""

from __future__ import annotations

from torch import nn


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
