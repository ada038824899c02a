"""Hooks that extend TorchRL's ``Trainer`` with what a multi-objective run needs."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.trainers.trainers import Trainer, TrainerHookBase

from morlnav.evaluation import Evaluation
from morlnav.limits import check_at_least


class PeriodicHook(TrainerHookBase):
    """Base of hooks that act every ``interval`` environment steps, and keep this rhythm in a resumed run.

    Args:
        interval: environment steps between two actions.

    Raises:
        ValueError: if it is below 1.
    """

    op: ClassVar[str] = "post_steps"
    """Where it is registered: by default after every round of optimisation steps."""

    name: ClassVar[str]
    """What a checkpoint calls it, unless :meth:`register` is told otherwise."""

    def __init__(self, interval: int) -> None:
        check_at_least(1, interval=interval)
        self.interval, self.last = interval, 0

    def register(self, trainer: Trainer, name: str | None = None) -> None:
        """Register with a trainer."""
        self.trainer = trainer
        trainer.register_op(self.op, self)
        trainer.register_module(name or self.name, self)

    def due(self, ahead: int = 0) -> bool:
        """Whether to act now, ``ahead`` steps beyond what the trainer counts; if so, the next time counts from here."""
        frames = self.trainer.collected_frames + ahead
        if frames - self.last < self.interval:
            return False
        self.last = frames
        return True

    def state_dict(self) -> dict[str, Any]:
        """When it last acted."""
        return {"last": self.last}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Keep the rhythm."""
        self.last = state_dict["last"]


class AnnealDiscount(TrainerHookBase):
    """Raise the discount γ from ``start`` to its final value: ``1 - γ`` falls geometrically, then stays.

    A short horizon first teaches to drive to the goal in minutes, the long one then resolves the style objectives
    (increasing discount factors after François-Lavet et al., 2015). The discount is that of the trainer's loss module.

    Args:
        start: discount at the beginning.
        end: final discount.
        fraction: share of the run over which γ rises.
        total_frames: environment steps of the run.

    Raises:
        ValueError: unless ``0 <= start <= end <= 1`` and ``0 <= fraction <= 1``.

    Examples:
        >>> AnnealDiscount.at(0.5, start=0.9, end=0.999)
        0.99
    """

    def __init__(self, start: float = 0.9, end: float = 0.99, fraction: float = 0.5, *, total_frames: int) -> None:
        if not 0 <= start <= end <= 1:
            raise ValueError(f"start and end must be discounts, 0 <= start <= end <= 1, got {start} and {end}.")
        if not 0 <= fraction <= 1:
            raise ValueError(f"fraction must be between 0 and 1, got {fraction}.")
        self.start, self.end, self.frames = start, end, int(fraction * total_frames)

    @staticmethod
    def at(progress: float, start: float, end: float) -> float:
        """Discount at a ``progress`` between 0 and 1."""
        if progress >= 1 or start == end:
            return end
        first, last = math.log(1 - start), math.log(max(1 - end, 1e-4))
        return round(1 - math.exp(first + progress * (last - first)), 10)

    def __call__(self) -> None:
        """Set γ for the coming optimisation steps."""
        progress = self.trainer.collected_frames / self.frames if self.frames else 1.0
        self.trainer.loss_module.value_estimator.gamma.fill_(self.at(progress, self.start, self.end))

    def register(self, trainer: Trainer, name: str = "anneal_discount") -> None:
        """Give the trainer's loss this discount, and register before every round of optimisation steps."""
        self.trainer, loss = trainer, trainer.loss_module
        device = next(loss.parameters()).device
        loss.make_value_estimator(gamma=self.end)
        loss.value_estimator.to(device)
        trainer.register_op("pre_optim_steps", self)


class StepExploration(TrainerHookBase):
    """Anneal the exploration noise, one step per collected batch.

    Args:
        module: exploration module with ``step``.
    """

    def __init__(self, module: torch.nn.Module) -> None:
        self.module = module

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """One annealing step per collected batch."""
        self.module.step(1)
        return batch

    def register(self, trainer: Trainer, name: str = "step_exploration") -> None:
        """Register on every collected batch."""
        trainer.register_op("batch_process", self)
        trainer.register_module(name, self)

    def state_dict(self) -> dict[str, Any]:
        """How far the noise is annealed, which not every collector saves with its policy."""
        return self.module.state_dict()

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` gave."""
        self.module.load_state_dict(state_dict)


class LogEpisodes(PeriodicHook):
    """Log finished episodes: return per objective, scalarised return wᵀr as in the trainer's loss, how they ended.

    Entries of a batch that the environment does not write, such as ``outcome``, are left out.

    Args:
        interval: write after at least this many frames, so that the means are of many episodes.
        rewards: names of the reward entries, in order.
    """

    op, name = "batch_process", "log_episodes"  # before hooks that drop entries

    def __init__(self, interval: int = 2560, *, rewards: Sequence[str]) -> None:
        super().__init__(interval)
        self.rewards = rewards
        self.names: list[str] = []
        self.rows: list[Tensor] = []

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """Gather episodes that ended in ``batch``; write their means once enough frames have passed."""
        following = batch.get("next")
        values = self._of(following[following.get("done").squeeze(-1)])
        self.names = list(values)
        self.rows.append(torch.stack(list(values.values()), -1))
        if self.due(ahead=batch.numel()):
            rows, self.rows = torch.cat(self.rows), []
            if len(rows):
                self._write(rows.mean(0), self.last)
        return batch

    def _of(self, episodes: TensorDictBase) -> dict[str, Tensor]:
        """What is logged of ended episodes ``[E]``, by name."""
        values = {}
        returns = episodes.get("episode_reward", None)
        if returns is not None:
            weights = self.trainer.loss_module.scalarisation(episodes.get("preference"), returns.shape[-1])
            values |= {f"return_{name}": returns[..., i] for i, name in enumerate(self.rewards)}
            values["return_scalarised"] = (weights * returns).sum(-1)
        outcome = episodes.get("outcome", None)
        values |= {} if outcome is None else {f"ended_{name}": flag.squeeze(-1) for name, flag in outcome.items()}
        truncated, steps = episodes.get("truncated", None), episodes.get("step_count", None)
        if truncated is not None:
            values["timeout"] = (truncated & ~episodes.get("terminated")).squeeze(-1)
        if steps is not None:
            values["episode_length"] = steps.squeeze(-1)
        return {name: value.float() for name, value in values.items()}

    def _write(self, means: Tensor, frames: int) -> None:
        metrics = dict(zip(self.names, means.tolist(), strict=True))
        for name, value in metrics.items():
            log_scalar(self.trainer, f"train/{name}", value, frames)
        shown = {"return_scalarised": "return", "ended_goal": "success"}
        for name, label in shown.items():
            if name in metrics and self.trainer.progress_bar:
                self.trainer._pbar_str[label] = metrics[name]

    def state_dict(self) -> dict[str, Any]:
        """Episodes gathered since the last line, so that a resumed run logs the same numbers."""
        return super().state_dict() | {"rows": torch.cat(self.rows) if self.rows else torch.zeros(0)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on gathering."""
        super().load_state_dict(state_dict)
        self.rows = [state_dict["rows"]] if len(state_dict["rows"]) else []


class LogOptimisation(PeriodicHook):
    """Log losses, gradient norms, what terms report, γ, learning rates, exploration noise and speeds.

    Args:
        interval: frames between two lines.
        rewards: names of the reward entries, in order.
        exploration: the noise; its present factor is its ``sigma``.
    """

    op, name = "post_optim_complete_log", "log_optimisation"

    def __init__(
        self, interval: int = 2560, *, rewards: Sequence[str], exploration: torch.nn.Module | None = None
    ) -> None:
        super().__init__(interval)
        self.rewards, self.exploration = rewards, exploration
        self.clock: tuple[float, int, int] | None = None

    def __call__(self, optim_steps: int, losses: TensorDictBase | None) -> None:
        """Write the averages of the last round of optimisation steps if a line is due."""
        frames = self.trainer.collected_frames
        now = (time.perf_counter(), frames, optim_steps)
        self.clock = self.clock or now
        if not self.due():
            return
        metrics: dict[str, float] = {}
        for key, value in losses.items() if losses is not None else ():
            if value.ndim:
                metrics |= {f"{key}_{n}": v for n, v in zip(self.rewards, value.tolist(), strict=True)}
            else:
                metrics[key] = value.item()
        metrics |= {name: float(value) for name, value in self._state().items()}
        elapsed = now[0] - self.clock[0]
        if elapsed > 0:
            metrics["frames_per_second"] = (frames - self.clock[1]) / elapsed
            metrics["updates_per_second"] = (optim_steps - self.clock[2]) / elapsed
        self.clock = now
        for name, value in metrics.items():
            log_scalar(self.trainer, f"optim/{name}", value, frames)

    def _state(self) -> dict[str, Any]:
        stepper = self.trainer.optimization_stepper
        state = {"gamma": self.trainer.loss_module.value_estimator.gamma.max()}
        state |= {f"lr_{name}": optimizer.param_groups[0]["lr"] for name, optimizer in stepper.optimizers.items()}
        return state | ({"exploration": self.exploration.sigma} if hasattr(self.exploration, "sigma") else {})


class EvaluatePolicy(PeriodicHook):
    """Measure the averaged actor on held-out episodes, and log what comes out.

    Args:
        interval: environment steps between two evaluations.
        episodes: per preference.
        steps: of the grid of preferences.
        evaluation: measures.
        policy: maps observations and preferences to actions.

    Raises:
        ValueError: for numbers below 1.
    """

    name = "evaluate_policy"

    def __init__(
        self,
        interval: int = 40_000,
        episodes: int = 12,
        steps: int = 4,
        *,
        evaluation: Evaluation,
        policy: torch.nn.Module,
    ) -> None:
        super().__init__(interval)
        check_at_least(1, episodes=episodes, steps=steps)
        self.episodes, self.steps, self.evaluation, self.policy = episodes, steps, evaluation, policy

    def __call__(self, batch: Any = None) -> None:
        """Evaluate if it is due."""
        if self.due():
            for name, value in self.evaluation.measure(self.policy, self.episodes, self.steps).items():
                log_scalar(self.trainer, f"evaluation/{name}", value, self.last)


def log_scalar(trainer: Trainer, name: str, value: float, frames: int) -> None:
    """Write one value, if the trainer has a logger."""
    if trainer.logger is not None:
        trainer.logger.log_scalar(name, value, step=frames)
