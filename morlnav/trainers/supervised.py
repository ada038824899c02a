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

from morlnav.limits import check_at_least, check_positive
from morlnav.modules.mode import eval_mode


class Fit:
    """Minimises a loss with AdamW and a one-cycle learning rate; keeps the weights that are best on held-out data.

    Args:
        steps: updates at the most.
        lr: largest learning rate.
        weight_decay: of AdamW.
        interval: updates between two looks at the held-out data.
        patience: stop after this many looks without a better held-out loss.

    Raises:
        ValueError: for numbers below what makes sense.

    Examples:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> from morlnav.objectives import BehaviourCloningLoss
        >>> _ = torch.manual_seed(0)
        >>> rows = TensorDict(observation=torch.randn(256, 3), batch_size=[256])
        >>> rows["action"] = rows["observation"][:, :1] / 2
        >>> actor = TensorDictModule(torch.nn.Linear(3, 1), ["observation"], ["action"])
        >>> loss = BehaviourCloningLoss(actor, bounds=(torch.tensor([-1.0]), torch.tensor([1.0])))
        >>> scores = Fit(steps=300, lr=0.03)(loss, lambda: rows[:200], rows[200:])
        >>> scores["loss_bc"] < 0.01
        True
    """

    def __init__(
        self, steps: int, lr: float = 1e-3, weight_decay: float = 1e-2, interval: int = 100, patience: int = 10
    ) -> None:
        check_at_least(1, steps=steps, interval=interval, patience=patience)
        check_at_least(0, weight_decay=weight_decay)
        check_positive(lr=lr)
        self.steps, self.lr, self.weight_decay = steps, lr, weight_decay
        self.interval, self.patience = interval, patience

    def __call__(
        self,
        loss: LossModule,
        sample: Callable[[], TensorDictBase],
        held_out: TensorDictBase,
        *,
        name: str = "fit",
        logger: Logger | None = None,
        progress_bar: bool = False,
    ) -> dict[str, float]:
        """Train.

        Args:
            loss: its entries whose names begin with ``loss`` are minimised.
            sample: draws a minibatch.
            held_out: data that is never trained on.
            name: prefix of the logged scalars and label of the progress bar.
            logger: receives training and held-out values.
            progress_bar: show one.

        Returns:
            The held-out loss and further scalars of the best weights, by name.

        Raises:
            ValueError: if nothing is held out, or the held-out loss is not finite.
        """
        if not len(held_out):
            raise ValueError(f"{name} has no held-out data to choose its weights by; raise its held_out.")
        params = [param for param in loss.parameters() if param.requires_grad]
        optimizer = torch.optim.AdamW(params, lr=self.lr, weight_decay=self.weight_decay, fused=True)
        scheduler = OneCycleLR(optimizer, max_lr=self.lr, total_steps=self.steps)
        best, best_state, waited = {}, deepcopy(loss.state_dict()), 0
        bar = trange(self.steps, desc=f"  {name}", disable=not progress_bar, leave=False)
        for step in bar:
            total = sum(value.sum() for key, value in loss(sample()).items() if key.startswith("loss"))
            optimizer.zero_grad(set_to_none=True)
            total.backward()
            optimizer.step()
            scheduler.step()
            if (step + 1) % self.interval and step + 1 < self.steps:
                continue
            with torch.no_grad(), eval_mode(loss):
                scores = {key: value.mean().item() for key, value in loss(held_out).items()}
            if not math.isfinite(_sum(scores)):
                raise ValueError(f"{name} diverged: its held-out loss is {_sum(scores)} after {step + 1} steps.")
            if logger is not None:
                logger.log_scalar(f"{name}/train_loss", total.item(), step=step + 1)
                for key, value in scores.items():
                    logger.log_scalar(f"{name}/held_out_{key}", value, step=step + 1)
            bar.set_postfix({key: f"{value:.4f}" for key, value in scores.items()})
            if not best or _sum(scores) < _sum(best):
                best, best_state, waited = scores, deepcopy(loss.state_dict()), 0
            else:
                waited += 1
            if waited >= self.patience:
                break
        loss.load_state_dict(best_state)
        return best


def _sum(scores: dict[str, float]) -> float:
    return sum(value for key, value in scores.items() if key.startswith("loss"))
