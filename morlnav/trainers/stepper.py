"""One optimisation step of MORL-TD3, for TorchRL's ``Trainer``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import optim
from torchrl.objectives import TargetNetUpdater
from torchrl.trainers.algorithms.td3 import TD3OptimizationStepper
from torchrl.trainers.trainers import Trainer


class MORLTD3Stepper(TD3OptimizationStepper):
    """Critics at every step; actor, targets and the averaged actor at every ``policy_update_delay``-th (PD-MORL).

    TorchRL's own stepper leaves the targets to a hook that runs after every critic step; here they move with the actor.

    Args:
        optimizer_actor: optimizer of the actor.
        optimizer_critic: optimizer of all critics.
        target_net_updater: moves the target networks.
        policy_update_delay: the actor is updated every this many steps.
        average: an :class:`torch.optim.swa_utils.AveragedModel` of the actor, updated with it.
        schedulers: learning-rate schedulers, stepped once per optimisation step.

    Examples:
        >>> stepper = MORLTD3Stepper(actor_optim, critic_optim, SoftUpdate(loss, tau=0.005))  # doctest: +SKIP
        >>> trainer = Trainer(..., optimization_stepper=stepper)  # doctest: +SKIP
    """

    def __init__(
        self,
        optimizer_actor: optim.Optimizer,
        optimizer_critic: optim.Optimizer,
        target_net_updater: TargetNetUpdater,
        *,
        policy_update_delay: int = 2,
        average: optim.swa_utils.AveragedModel | None = None,
        schedulers: Sequence[optim.lr_scheduler.LRScheduler] = (),
    ) -> None:
        super().__init__(optimizer_actor, optimizer_critic, policy_update_delay=policy_update_delay)
        self.target_net_updater = target_net_updater
        self.average = average
        self.schedulers = list(schedulers)

    def step(self, trainer: Trainer, sub_batch: TensorDictBase) -> TensorDictBase:
        """Update on ``sub_batch``; returns losses, gradient norms, angles and mean values per objective."""
        self._update_counter += 1
        loss, critic = trainer.compute_loss(sub_batch, method="value_loss")
        metrics = {"loss_qvalue": loss.detach(), "grad_norm_qvalue": self._apply(trainer, loss, self.optimizer_critic)}
        metrics["pred_value"] = critic["pred_value"].mean((0, 1))
        if "angle_qvalue" in critic:
            metrics["angle_qvalue"] = critic["angle_qvalue"].mean()

        actor_turn = self._update_counter % self.policy_update_delay == 0
        if actor_turn:
            loss, actor = trainer.compute_loss(sub_batch, method="actor_loss")
            metrics["grad_norm_actor"] = self._apply(trainer, loss, self.optimizer_actor)
            metrics["loss_actor"] = loss.detach()
            if "angle_actor" in actor:
                metrics["angle_actor"] = actor["angle_actor"].mean()
            self.target_net_updater.step()
            if self.average is not None:
                self.average.update_parameters(trainer.loss_module.actor_network)
        for scheduler in self.schedulers:
            scheduler.step()

        if hasattr(trainer.replay_buffer, "update_tensordict_priority"):
            sub_batch.set(trainer.loss_module.tensor_keys.priority, critic["td_error"].max(0)[0])
            trainer.replay_buffer.update_tensordict_priority(sub_batch)
        self.last_metrics = TensorDict(metrics) if actor_turn else self.last_metrics.update(TensorDict(metrics))
        return self.last_metrics.clone()

    def _apply(self, trainer: Trainer, loss: torch.Tensor, optimizer: optim.Optimizer) -> torch.Tensor:
        loss.backward()
        limit = trainer.clip_norm if trainer.clip_norm is not None else float("inf")
        norm = torch.nn.utils.clip_grad_norm_(list(self._params(optimizer)), limit)
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        return norm.detach()
