"""Supervised training of a loss module, as cloning and ranking need it."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy

import torch
from tensordict import TensorDictBase
from torch.optim.lr_scheduler import OneCycleLR
from torchrl.objectives.common import LossModule
from torchrl.record.loggers import Logger
from tqdm import trange

from morlnav.envs import eval_mode


def fit(
    loss: LossModule,
    sample: Callable[[], TensorDictBase],
    held_out: TensorDictBase,
    *,
    steps: int,
    lr: float = 1e-3,
    weight_decay: float = 1e-2,
    interval: int = 100,
    patience: int = 10,
    name: str = "fit",
    logger: Logger | None = None,
    progress_bar: bool = True,
) -> dict[str, float]:
    """Minimise a loss with AdamW and a one-cycle learning rate; keep the weights that are best on held-out data.

    Args:
        loss: its entries whose names begin with ``loss`` are minimised.
        sample: draws a minibatch.
        held_out: data that is never trained on.
        steps: updates at the most.
        lr: largest learning rate.
        weight_decay: of AdamW.
        interval: updates between two looks at the held-out data.
        patience: stop after this many looks without a better held-out loss.
        name: prefix of the logged scalars and label of the progress bar.
        logger: receives training and held-out values.
        progress_bar: show one.

    Returns:
        The held-out loss and further scalars of the best weights, by name.

    Raises:
        ValueError: if ``steps`` is below 1, nothing is held out, or the held-out loss is not finite.

    Examples:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> from morlnav.objectives import BehaviourCloningLoss
        >>> _ = torch.manual_seed(0)
        >>> rows = TensorDict(observation=torch.randn(256, 3), batch_size=[256])
        >>> rows["action"] = rows["observation"][:, :1] / 2
        >>> actor = TensorDictModule(torch.nn.Linear(3, 1), ["observation"], ["action"])
        >>> loss = BehaviourCloningLoss(actor, bounds=(torch.tensor([-1.0]), torch.tensor([1.0])))
        >>> scores = fit(loss, lambda: rows[:200], rows[200:], steps=300, lr=0.03, progress_bar=False)
        >>> scores["loss_bc"] < 0.01
        True
    """
    if steps < 1:
        raise ValueError(f"{name} needs at least one step, got {steps}.")
    if not len(held_out):
        raise ValueError(f"{name} has no held-out data to choose its weights by; raise its held_out.")
    params = [param for param in loss.parameters() if param.requires_grad]
    optimizer = torch.optim.AdamW(params, lr=lr, weight_decay=weight_decay, fused=True)
    scheduler = OneCycleLR(optimizer, max_lr=lr, total_steps=steps)
    best, best_state, waited = {}, deepcopy(loss.state_dict()), 0
    bar = trange(steps, desc=f"  {name}", disable=not progress_bar, leave=False)
    for step in bar:
        out = loss(sample())
        total = _total(out)
        optimizer.zero_grad(set_to_none=True)
        total.backward()
        optimizer.step()
        scheduler.step()
        if (step + 1) % interval and step + 1 < steps:
            continue
        with torch.no_grad(), eval_mode(loss):
            scores = {key: value.mean().item() for key, value in loss(held_out).items()}
        if not math.isfinite(sum_losses(scores)):
            raise ValueError(f"{name} diverged: its held-out loss is {sum_losses(scores)} after {step + 1} steps.")
        if logger is not None:
            logger.log_scalar(f"{name}/train_loss", total.item(), step=step + 1)
            for key, value in scores.items():
                logger.log_scalar(f"{name}/held_out_{key}", value, step=step + 1)
        bar.set_postfix({key: f"{value:.4f}" for key, value in scores.items()})
        if not best or sum_losses(scores) < sum_losses(best):
            best, best_state, waited = scores, deepcopy(loss.state_dict()), 0
        else:
            waited += 1
        if waited >= patience:
            break
    loss.load_state_dict(best_state)
    return best


def sum_losses(scores: dict[str, float]) -> float:
    """Sum of the entries whose names begin with ``loss``.

    >>> sum_losses({"loss_bc": 1.0, "error": 5.0})
    1.0
    """
    return sum(value for key, value in scores.items() if key.startswith("loss"))


def _total(out: TensorDictBase) -> torch.Tensor:
    return sum(value.sum() for key, value in out.items() if key.startswith("loss"))
