"""TorchRL's ``Trainer`` with the settings that a multi-objective run needs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.checkpoint import CheckpointRotation, GlobalRNGState
from torchrl.collectors import BaseCollector
from torchrl.data import ReplayBuffer
from torchrl.objectives import LossModule
from torchrl.record.loggers import Logger
from torchrl.trainers.trainers import OptimizationStepper, Trainer

from morlnav.limits import check_at_least, check_positive
from morlnav.trainers.checkpoint import ListedCheckpoint


class MORLTrainer(Trainer):
    """Trains for a number of frames, and leaves checkpoints that continue bit for bit.

    Args:
        total_frames: environment steps in all.
        optim_steps_per_batch: updates after each collected batch.
        clip_norm: of gradients.
        log_interval: frames between two lines of the logs of hooks that return values to log.
        checkpoint_interval: frames between two checkpoints.
        keep_checkpoints: how many of them are kept.
        progress_bar: show one.
        collector: gives batches of transitions.
        loss_module: both losses.
        optimization_stepper: one update.
        replay_buffer: what updates learn from.
        logger: receives scalars.
        directory: receives ``checkpoints/``.
        components: more objects that a checkpoint holds.

    Raises:
        ValueError: for numbers below what makes sense.
    """

    def __init__(
        self,
        total_frames: int,
        optim_steps_per_batch: int = 16,
        clip_norm: float | None = 10.0,
        log_interval: int = 2560,
        checkpoint_interval: int = 100_000,
        keep_checkpoints: int = 2,
        progress_bar: bool = True,
        *,
        collector: BaseCollector,
        loss_module: LossModule,
        optimization_stepper: OptimizationStepper,
        replay_buffer: ReplayBuffer,
        logger: Logger | None,
        directory: Path,
        components: Mapping[str, Any],
    ) -> None:
        check_at_least(1, total_frames=total_frames, optim_steps_per_batch=optim_steps_per_batch)
        check_at_least(1, log_interval=log_interval, checkpoint_interval=checkpoint_interval)
        check_at_least(1, keep_checkpoints=keep_checkpoints)
        check_positive(clip_norm=clip_norm)
        super().__init__(
            collector=collector,
            total_frames=total_frames,
            frame_skip=1,
            loss_module=loss_module,
            optimization_stepper=optimization_stepper,
            replay_buffer=replay_buffer,
            optim_steps_per_batch=optim_steps_per_batch,
            logger=logger,
            clip_norm=clip_norm,
            progress_bar=progress_bar,
            log_interval=log_interval,
            auto_log_optim_steps=False,  # our hooks average what they write
            checkpoint=ListedCheckpoint(rng=GlobalRNGState(), **components),
            checkpoint_rotation=CheckpointRotation(directory / "checkpoints", keep_last=keep_checkpoints),
            save_trainer_interval=checkpoint_interval,
        )
