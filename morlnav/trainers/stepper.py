"""One optimisation step of MORL-TD3, for TorchRL's ``Trainer``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn, optim
from torch.optim.lr_scheduler import LambdaLR, LRScheduler
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.data import PrioritizedSampler
from torchrl.objectives import SoftUpdate, TD3Loss
from torchrl.objectives.utils import TargetNetUpdater
from torchrl.trainers.algorithms.td3 import TD3OptimizationStepper
from torchrl.trainers.trainers import Trainer

from morlnav.config import Part, setting, supply, takes
from morlnav.limits import check_at_least
from morlnav.objectives import MORLTD3Loss

TD3_KEYS = frozenset(TD3Loss.out_keys)


def linear_decay(optimizer: optim.Optimizer, total_steps: int, start: float = 0.5, end: float = 0.02) -> LambdaLR:
    """A learning rate that is constant at first, and then falls linearly.

    Args:
        optimizer: whose rate it is.
        total_steps: updates of the run.
        start: share of the updates after which it falls ...
        end: ... to this share of its value.

    Raises:
        ValueError: unless both are shares.

    Examples:
        >>> optimizer = torch.optim.SGD([torch.zeros(1)], lr=1.0)
        >>> schedule = linear_decay(optimizer, total_steps=4, start=0.5, end=0.0)
        >>> for _ in range(3):
        ...     optimizer.step()
        ...     schedule.step()
        >>> schedule.get_last_lr()
        [0.5]
    """
    if not 0 <= start < 1:
        raise ValueError(f"start must be from 0 to below 1, got {start}.")
    if not 0 <= end <= 1:
        raise ValueError(f"end must be from 0 to 1, got {end}.")

    def factor(step: int) -> float:
        progress = step / total_steps
        return 1.0 if progress <= start else max(end, 1 - (1 - end) * (progress - start) / (1 - start))

    return LambdaLR(optimizer, factor)


class MORLTD3Stepper(TD3OptimizationStepper):
    """Critics at every step; actor, targets and the averaged actor at every ``policy_update_delay``-th (PD-MORL).

    TorchRL's own stepper leaves the targets to a hook that runs after every critic step; here they move with the actor.
    What it reports is a copy, for a loss compiled with CUDA graphs writes its next results to the same place. Of the
    loss it reports the mean of every entry of its ``out_keys`` that TD3 does not have, such as what its terms add.

    Args:
        optimizer_actor: optimizer of the actor, called with its ``params``.
        optimizer_critic: optimizer of all critics.
        target_net_updater: moves the target networks, called with the ``loss_module``.
        schedule: of a learning rate, called with the ``optimizer`` and its ``total_steps``; ``None`` is constant.
        policy_update_delay: the actor is updated every this many steps.
        average_decay: of the averaged actor, per update of the actor; 0 keeps the actor itself.
        loss: both losses.
        actor: the actor's own module, which shares its parameters with the loss.
        total_updates: of the run.

    Raises:
        ValueError: for numbers out of range.

    Examples:
        >>> from functools import partial
        >>> adam = partial(torch.optim.Adam, lr=1e-3)
        >>> MORLTD3Stepper(adam, adam, partial(SoftUpdate, tau=0.005), loss=loss, actor=actor)  # doctest: +SKIP
    """

    def __init__(
        self,
        optimizer_actor: Part[optim.Optimizer] = partial(optim.Adam, lr=5e-4, fused=True),  # noqa: B008
        optimizer_critic: Part[optim.Optimizer] = partial(optim.Adam, lr=1e-3, fused=True),  # noqa: B008
        target_net_updater: Part[TargetNetUpdater] = partial(SoftUpdate, tau=0.05),  # noqa: B008
        schedule: Part[LRScheduler] | None = linear_decay,
        policy_update_delay: int = 2,
        average_decay: float = 0.9995,
        *,
        loss: MORLTD3Loss,
        actor: nn.Module,
        total_updates: int = 1,
    ) -> None:
        check_at_least(1, policy_update_delay=policy_update_delay)
        if not 0 <= average_decay < 1:
            raise ValueError(f"average_decay must be from 0 to below 1, got {average_decay}.")
        tau = setting(target_net_updater, "tau") if "tau" in takes(target_net_updater) else None
        if tau is not None and not 0 < tau <= 1:  # TorchRL speaks of its eps = 1 - tau, and lets targets stand still
            raise ValueError(f"target_net_updater.tau must be above 0 and at most 1, got {tau}.")
        self.optimizers = {
            "actor": supply(optimizer_actor, params=list(loss.actor_network_params.parameters())),
            "critic": supply(optimizer_critic, params=list(loss.qvalue_network_params.parameters())),
        }
        super().__init__(*self.optimizers.values(), policy_update_delay=policy_update_delay)
        self.target_net_updater = supply(target_net_updater, loss_module=loss)
        self.actor = actor
        self.average = AveragedModel(actor, multi_avg_fn=get_ema_multi_avg_fn(average_decay))
        steps = {"actor": max(1, total_updates // policy_update_delay), "critic": total_updates}
        self.schedulers = {
            name: supply(schedule, optimizer=optimizer, total_steps=steps[name])
            for name, optimizer in self.optimizers.items()
            if schedule is not None
        }
        self._reported = [key for key in loss.out_keys if key not in TD3_KEYS]
        self._actor_metrics = {key: torch.zeros(()) for key in ("loss_actor", "grad_norm_actor")}
        self._actor_metrics |= {key: torch.zeros(()) for key in self._reported if key.endswith("_actor")}

    def state_dict(self) -> dict[str, Any]:
        """Optimizers, learning-rate schedulers, the update counter, and what the last actor update reported."""
        return super().state_dict() | {
            "schedulers": {name: scheduler.last_epoch for name, scheduler in self.schedulers.items()},
            "actor_metrics": dict(self._actor_metrics),
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` gave."""
        super().load_state_dict(state_dict)
        for name, scheduler in self.schedulers.items():
            scheduler.last_epoch = int(state_dict["schedulers"][name])
        self._actor_metrics = dict(state_dict["actor_metrics"])

    def step(self, trainer: Trainer, sub_batch: TensorDictBase) -> TensorDictBase:
        """Update on ``sub_batch``; returns losses, gradient norms, mean values per objective and further reports."""
        self._update_counter += 1
        loss, critic = trainer.compute_loss(sub_batch, method="value_loss")
        gradient = self._apply(trainer, loss, "critic")
        metrics = {"loss_qvalue": loss.detach().clone(), "grad_norm_qvalue": gradient}
        metrics["pred_value"] = critic["pred_value"].flatten(0, -2).mean(0)
        metrics |= self._reports(critic)
        if isinstance(getattr(trainer.replay_buffer, "sampler", None), PrioritizedSampler):
            sub_batch.set(trainer.loss_module.tensor_keys.priority, critic["td_error"].max(0)[0])
            trainer.replay_buffer.update_tensordict_priority(sub_batch)
        if self._update_counter % self.policy_update_delay == 0:
            self._actor_metrics = self._update_actor(trainer, sub_batch)
        return TensorDict(metrics | self._actor_metrics)

    def _update_actor(self, trainer: Trainer, sub_batch: TensorDictBase) -> dict[str, torch.Tensor]:
        loss, actor = trainer.compute_loss(sub_batch, method="actor_loss")
        gradient = self._apply(trainer, loss, "actor")
        self.target_net_updater.step()
        self.average.update_parameters(self.actor)
        return {"loss_actor": loss.detach().clone(), "grad_norm_actor": gradient, **self._reports(actor)}

    def _reports(self, metadata: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        return {key: metadata[key].mean() for key in self._reported if key in metadata}

    def _apply(self, trainer: Trainer, loss: torch.Tensor, name: str) -> torch.Tensor:
        optimizer = self.optimizers[name]
        loss.backward()
        limit = trainer.clip_norm if trainer.clip_norm is not None else float("inf")
        norm = nn.utils.clip_grad_norm_(list(self._params(optimizer)), limit)
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        if name in self.schedulers:
            self.schedulers[name].step()
        return norm.detach()
