"""Hooks that extend TorchRL's ``Trainer`` with what a multi-objective run needs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.trainers.trainers import Trainer, TrainerHookBase


class PeriodicHook(TrainerHookBase):
    """Base of hooks that act every ``frames`` environment steps, and keep this rhythm in a resumed run.

    Args:
        frames: environment steps between two actions.
    """

    def __init__(self, frames: int) -> None:
        self.frames, self.last = frames, 0

    def due(self) -> bool:
        """Whether to act now; if so, the next time is counted from here."""
        frames = self.trainer.collected_frames
        if frames - self.last < self.frames:
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
    (increasing discount factors after François-Lavet et al., 2015).

    The discount is that of the trainer's loss module.

    Args:
        start: discount at the beginning.
        end: discount from ``frames`` on; one for all, or one per entry of the reward.
        frames: environment steps over which γ rises.

    Raises:
        ValueError: unless ``0 <= start <= end <= 1``.

    Examples:
        >>> AnnealDiscount.at(0.5, start=0.9, end=0.999)
        0.99
    """

    def __init__(self, start: float, end: float | Sequence[float], frames: int) -> None:
        self.ends = [end] if isinstance(end, (int, float)) else list(end)
        if not all(0 <= start <= value <= 1 for value in self.ends):
            raise ValueError(f"Discounts need 0 <= gamma_start <= gamma <= 1, got gamma_start={start} and gamma={end}.")
        self.start, self.frames = start, frames

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
        gamma = self.trainer.loss_module.value_estimator.gamma
        gamma.copy_(gamma.new_tensor([self.at(progress, self.start, end) for end in self.ends]).reshape(gamma.shape))

    def register(self, trainer: Trainer, name: str = "anneal_discount") -> None:
        """Register before every round of optimisation steps."""
        self.trainer = trainer
        trainer.register_op("pre_optim_steps", self)

    def state_dict(self) -> dict[str, Any]:
        """Nothing: γ follows from the number of frames."""
        return {}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Nothing to load."""


class StepExploration(TrainerHookBase):
    """Anneal the exploration noise, one step per collected batch.

    Args:
        module: exploration module with ``step``, by default the trainer's ``exploration_module``.
    """

    def __init__(self, module: torch.nn.Module | None = None) -> None:
        self.module = module

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """One annealing step per collected batch."""
        self.module.step(1)
        return batch

    def register(self, trainer: Trainer, name: str = "step_exploration") -> None:
        """Register on every collected batch."""
        self.module = self.module or trainer.exploration_module
        trainer.register_op("batch_process", self)
        trainer.register_module(name, self)

    def state_dict(self) -> dict[str, Any]:
        """How far the noise is annealed, which not every collector saves with its policy."""
        return self.module.state_dict()

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` gave."""
        self.module.load_state_dict(state_dict)


class LogEpisodes(TrainerHookBase):
    """Log finished episodes: return per objective, scalarised return wᵀr as in the trainer's loss, outcomes and length.

    Args:
        rewards: names of the reward entries, in order.
        frames: write after at least this many frames, so that the rates average many episodes.
    """

    def __init__(self, rewards: Sequence[str], frames: int) -> None:
        self.rewards, self.frames = rewards, frames
        self.rows: list[Tensor] = []
        self.last = 0

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """Gather episodes that ended in ``batch``; write their means once enough frames have passed."""
        following = batch.get("next")
        ended = following.get("done").squeeze(-1)
        episodes = following[ended]
        returns = episodes.get("episode_reward")
        weights = self.trainer.loss_module.scalarisation(episodes.get("preference"), returns.shape[-1])
        outcome = episodes.get("outcome")
        self.rows.append(
            torch.cat(
                [
                    returns,
                    (weights * returns).sum(-1, keepdim=True),
                    *(outcome.get(name).to(returns.dtype) for name in ("goal", "human", "box")),
                    (episodes.get("truncated") & ~episodes.get("terminated")).to(returns.dtype),
                    episodes.get("step_count").to(returns.dtype),
                ],
                -1,
            )
        )
        frames = self.trainer.collected_frames + batch.numel()
        if frames - self.last >= self.frames:
            self.last = frames
            rows, self.rows = torch.cat(self.rows), []
            if len(rows):
                self._write(rows.mean(0), frames)
        return batch

    def _write(self, means: Tensor, frames: int) -> None:
        names = [f"return_{name}" for name in self.rewards]
        names += ["return_scalarised", "success", "collision_human", "collision_box", "timeout", "episode_length"]
        metrics = {f"train/{name}": value for name, value in zip(names, means.tolist(), strict=True)}
        for name, value in metrics.items():
            self.trainer.logger.log_scalar(name, value, step=frames)
        self.trainer._log(success=metrics["train/success"], log_pbar=True)

    def register(self, trainer: Trainer, name: str = "log_episodes") -> None:
        """Register on collected batches; must come before hooks that drop entries."""
        self.trainer = trainer
        trainer.register_op("batch_process", self)
        trainer.register_module(name, self)

    def state_dict(self) -> dict[str, Any]:
        """Episodes gathered since the last line, so that a resumed run logs the same numbers."""
        return {"last": self.last, "rows": torch.cat(self.rows) if self.rows else torch.zeros(0)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on gathering."""
        self.last = state_dict["last"]
        self.rows = [state_dict["rows"]] if len(state_dict["rows"]) else []


class LogOptimisation(PeriodicHook):
    """Log losses, gradient norms, angles, γ, learning rates, exploration noise and speeds every ``frames`` frames.

    Args:
        rewards: names of the reward entries, in order.
        frames: distance between two lines.
        scalars: further values by name, called when a line is due.
    """

    def __init__(
        self, rewards: Sequence[str], frames: int, scalars: Mapping[str, Callable[[], Any]] | None = None
    ) -> None:
        super().__init__(frames)
        self.rewards, self.scalars = rewards, dict(scalars or {})
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
        metrics |= {name: float(read()) for name, read in self.scalars.items()}
        elapsed = now[0] - self.clock[0]
        if elapsed > 0:
            metrics["frames_per_second"] = (frames - self.clock[1]) / elapsed
            metrics["updates_per_second"] = (optim_steps - self.clock[2]) / elapsed
        self.clock = now
        for name, value in metrics.items():
            self.trainer.logger.log_scalar(f"optim/{name}", value, step=frames)

    def register(self, trainer: Trainer, name: str = "log_optimisation") -> None:
        """Register after every round of optimisation steps."""
        self.trainer = trainer
        trainer.register_op("post_optim_complete_log", self)
        trainer.register_module(name, self)
