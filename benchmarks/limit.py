"""The machine's limit: its fastest matrix products, and the fewest operations that an update needs."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from benchmarks.timing import Effort, duration


def update_flops(actor: nn.Module, critic: nn.Module, batch_size: int, policy_update_delay: int = 2) -> float:
    """The fewest floating-point operations of one update of twin critics, and every few updates of the actor.

    A layer ``[out, in]`` costs a forward pass ``2·B·in·out`` operations, the gradient of its weights as much again, and
    so does that of its inputs, which first layers do not need, but for the critic's two inputs that are the action. The
    critics' update takes a forward pass of the target actor and of both target critics, and forward and backward passes
    of both critics; the actor's takes forward and backward passes of itself and of one critic, whose weights need no
    gradient.

    Examples:
        >>> layer = nn.Linear(3, 5)
        >>> update_flops(layer, layer, batch_size=1, policy_update_delay=1)  # 30 operations per pass
        350.0
    """
    actor_pass, actor_first = _macs(actor)
    critic_pass, critic_first = _macs(critic)
    last = [layer for layer in actor.modules() if isinstance(layer, nn.Linear)][-1]
    first = next(layer for layer in critic.modules() if isinstance(layer, nn.Linear))
    to_action = first.out_features * last.out_features  # the gradient with respect to the action alone
    critics = actor_pass + 2 * critic_pass + 2 * (3 * critic_pass - critic_first)
    policy = 3 * actor_pass - actor_first + 2 * critic_pass - critic_first + to_action
    return 2.0 * batch_size * (critics + policy / policy_update_delay)


def _macs(module: nn.Module) -> tuple[int, int]:
    """Multiply-adds per sample of all linear layers, and of the first."""
    layers = [layer.weight.numel() for layer in module.modules() if isinstance(layer, nn.Linear)]
    return sum(layers), layers[0]


def matrix_product(effort: Effort, flops: float, cells: int = 256) -> tuple[Callable[[], object], float]:
    """The fastest of several matrix products at the networks' size or larger.

    Returns:
        The product, and how many updates of ``flops`` operations one call of it is worth.
    """

    def make(count: int, rows: int, inner: int, columns: int) -> tuple[Callable[[], Tensor], float]:
        left = torch.randn(count, rows, inner, device=effort.device).squeeze(0)
        right = torch.randn(count, inner, columns, device=effort.device).squeeze(0)
        out = left @ right
        return (lambda: torch.matmul(left, right, out=out)), 2.0 * count * rows * inner * columns

    sizes = [(1, cells, cells, cells), (2, cells, cells, cells), (1, 4 * cells, 4 * cells, 4 * cells)]
    candidates = [make(*size) for size in (sizes[:1] if effort.quick else sizes)]
    rates = []
    for product, work in candidates:
        duration(product, 3, effort.device)
        calls = 100 if work < 1e9 else 4
        rates.append(max(calls * work / duration(product, calls, effort.device) for _ in range(3)))
    product, work = candidates[rates.index(max(rates))]
    return product, work / flops
