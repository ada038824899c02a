"""One optimisation step of MORL-TD3, for TorchRL's ``Trainer``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import optim
from torchrl.data import PrioritizedSampler
from torchrl.objectives import TD3Loss
from torchrl.objectives.utils import TargetNetUpdater
from torchrl.trainers.algorithms.td3 import TD3OptimizationStepper
from torchrl.trainers.trainers import Trainer

TD3_KEYS = frozenset(TD3Loss.out_keys)


class MORLTD3Stepper(TD3OptimizationStepper):
    """Critics at every step; actor, targets and the averaged actor at every ``policy_update_delay``-th (PD-MORL).

    TorchRL's own stepper leaves the targets to a hook that runs after every critic step; here they move with the actor.
    What it reports is a copy, for a loss compiled with CUDA graphs writes its next results to the same place. Of the
    loss it reports the mean of every entry of its ``out_keys`` that TD3 does not have, such as what its terms add.

    Args:
        optimizer_actor: optimizer of the actor.
        optimizer_critic: optimizer of all critics.
        target_net_updater: moves the target networks.
        policy_update_delay: the actor is updated every this many steps.
        actor: the actor's own module, which shares its parameters with the loss.
        average: an :class:`torch.optim.swa_utils.AveragedModel` of the actor, updated with it.
        schedulers: learning-rate schedulers of the actor and of the critics, each stepped with its optimizer.

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
        actor: torch.nn.Module | None = None,
        average: optim.swa_utils.AveragedModel | None = None,
        schedulers: Sequence[optim.lr_scheduler.LRScheduler] = (),
    ) -> None:
        super().__init__(optimizer_actor, optimizer_critic, policy_update_delay=policy_update_delay)
        self.target_net_updater = target_net_updater
        self.actor = actor
        self.average = average
        self.schedulers = list(schedulers)
        self._actor_metrics: dict[str, torch.Tensor] = {
            key: torch.zeros(()) for key in ("loss_actor", "grad_norm_actor")
        }

    def state_dict(self) -> dict[str, Any]:
        """Optimizers, learning-rate schedulers, the update counter, and what the last actor update reported."""
        return super().state_dict() | {
            "schedulers": [scheduler.last_epoch for scheduler in self.schedulers],
            "actor_metrics": dict(self._actor_metrics),
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` gave."""
        super().load_state_dict(state_dict)
        for scheduler, epoch in zip(self.schedulers, state_dict["schedulers"], strict=True):
            scheduler.last_epoch = int(epoch)
        self._actor_metrics = dict(state_dict.get("actor_metrics", self._actor_metrics))

    def step(self, trainer: Trainer, sub_batch: TensorDictBase) -> TensorDictBase:
        """Update on ``sub_batch``; returns losses, gradient norms, mean values per objective and further reports."""
        self._update_counter += 1
        if self._update_counter == 1:  # the actor waits, but every step reports the same entries
            reported = [key for key in trainer.loss_module.out_keys if key not in TD3_KEYS and key.endswith("_actor")]
            self._actor_metrics |= {key: torch.zeros(()) for key in reported}
        loss, critic = trainer.compute_loss(sub_batch, method="value_loss")
        gradient = self._apply(trainer, loss, self.optimizer_critic)
        metrics = {"loss_qvalue": loss.detach().clone(), "grad_norm_qvalue": gradient}
        self._step_scheduler(1)
        metrics["pred_value"] = critic["pred_value"].flatten(0, -2).mean(0)
        metrics |= self._reports(trainer, critic)
        if isinstance(getattr(trainer.replay_buffer, "sampler", None), PrioritizedSampler):
            sub_batch.set(trainer.loss_module.tensor_keys.priority, critic["td_error"].max(0)[0])
            trainer.replay_buffer.update_tensordict_priority(sub_batch)
        if self._update_counter % self.policy_update_delay == 0:
            self._actor_metrics = self._update_actor(trainer, sub_batch)
        return TensorDict(metrics | self._actor_metrics)

    def _update_actor(self, trainer: Trainer, sub_batch: TensorDictBase) -> dict[str, torch.Tensor]:
        loss, actor = trainer.compute_loss(sub_batch, method="actor_loss")
        gradient = self._apply(trainer, loss, self.optimizer_actor)
        metrics = {"loss_actor": loss.detach().clone(), "grad_norm_actor": gradient}
        metrics |= self._reports(trainer, actor)
        self._step_scheduler(0)
        self.target_net_updater.step()
        if self.average is not None:
            self.average.update_parameters(self.actor)
        return metrics

    def _reports(self, trainer: Trainer, metadata: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        reported = [key for key in trainer.loss_module.out_keys if key not in TD3_KEYS]
        return {key: metadata[key].mean() for key in reported if key in metadata}

    def _step_scheduler(self, which: int) -> None:
        if self.schedulers:
            self.schedulers[which].step()

    def _apply(self, trainer: Trainer, loss: torch.Tensor, optimizer: optim.Optimizer) -> torch.Tensor:
        loss.backward()
        limit = trainer.clip_norm if trainer.clip_norm is not None else float("inf")
        norm = torch.nn.utils.clip_grad_norm_(list(self._params(optimizer)), limit)
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        return norm.detach()
