"""A loss that computes faster: its products rounded, its methods compiled."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from morlnav.modules import round_products
from morlnav.objectives import MORLTD3Loss


def product_dtype(name: str, device: torch.device) -> torch.dtype:
    """The type in which hidden layers multiply while learning: ``auto`` is bfloat16 where ``device`` is made for it.

    >>> product_dtype("float32", torch.device("cpu"))
    torch.float32
    """
    if name != "auto":
        return getattr(torch, name)
    capabilities = getattr(torch.cpu, "get_capabilities", dict)()
    fast = torch.cuda.is_bf16_supported() if device.type == "cuda" else capabilities.get("avx512_bf16", False)
    return torch.bfloat16 if fast else torch.float32


def hasten(loss: MORLTD3Loss, dtype: torch.dtype, compile: Mapping[str, Any] | None = None) -> None:
    """Let the hidden layers of all networks multiply in a type, and compile both losses.

    Args:
        loss: is changed in place.
        dtype: of the products.
        compile: arguments of ``torch.compile``; ``None`` is eager.

    Raises:
        ValueError: for arguments that it does not take.
    """
    for module in (loss.actor_network, loss.qvalue_network, loss.terms):  # a loss hides networks from modules()
        round_products(module, dtype)
    if compile is None:
        return
    try:
        for method in ("value_loss", "actor_loss"):
            setattr(loss, method, torch.compile(getattr(loss, method), **compile))
    except (TypeError, RuntimeError) as error:
        message = f"compile must be null or arguments of torch.compile, as {{mode: default}}, got {dict(compile)}."
        raise ValueError(message) from error
