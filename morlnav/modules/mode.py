"""Roll-outs in evaluation mode, amid a training."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from torch import nn


@contextmanager
def eval_mode(policy: Any) -> Iterator[None]:
    """Put a policy into evaluation mode, and every part of it back into its own mode afterwards.

    Dropout and batch normalisation would otherwise act, and learn, while a policy is measured.

    Args:
        policy: a module, or a TorchRL loss, whose networks are meant then; any other callable is left as it is.

    Examples:
        >>> policy = nn.Sequential(nn.Dropout(), nn.Dropout().eval())
        >>> with eval_mode(policy):
        ...     [part.training for part in policy]
        [False, False]
        >>> [part.training for part in policy]
        [True, False]
    """
    networks = [policy, *vars(policy).values()] if isinstance(policy, nn.Module) else []  # a loss's are no submodules
    parts = {part for network in networks if isinstance(network, nn.Module) for part in network.modules()}
    modes = [(part, part.training) for part in parts]
    for part, _ in modes:
        part.training = False
    try:
        yield
    finally:
        for part, training in modes:
            part.training = training
