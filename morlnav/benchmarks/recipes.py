"""Trainers of ``morlnav-train``'s recipes, ready to be measured."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig
from tensordict import TensorDictBase
from torchrl.trainers.trainers import Trainer

from morlnav.benchmarks.timing import Effort
from morlnav.cli import conf_dir
from morlnav.record.loggers import TensorboardCSVLogger
from morlnav.trainers import make_trainer
from morlnav.trainers.drex import STAGES, make_demonstrations, stage_directory, train_clone, train_reward
from morlnav.trainers.styles import style_config

ANALYTICAL = "objectives=[baseline,distance,efficiency]"
HARDLY_TRAINED = (
    "demonstrations.num=8",
    "demonstrations.num_envs=16",
    "clone.fit.steps=1",
    "ranking.levels=[0.0,0.9]",
    "ranking.episodes=2",
    "ranking.normalise=false",
    "ranking.batch_size=4",
    "ranking.fit.steps=1",
)
"""Clone and reward model have their full size but know nothing, which costs a step as much."""

UNDISTURBED = (
    "trainer.progress_bar=false",
    "trainer.checkpoint.interval=1000000000",
    "evaluation.during.interval=1000000000",
)
QUICK = (
    ANALYTICAL,
    "networks.actor.num_cells=32",
    "networks.critic.num_cells=32",
    "env.num_envs=16",
    "trainer.frames_per_batch=16",
)


@cache
def _scratch() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="morlnav-benchmark-")


def recipe(effort: Effort, *overrides: str) -> DictConfig:
    """The config of ``morlnav-train OVERRIDES`` without evaluations and checkpoints, with its reward model at hand."""
    device = torch.device(effort.device)
    fixed = (*UNDISTURBED, f"device={device}", f"cache={_scratch().name}/cache", f"threads={torch.get_num_threads()}")
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        cfg = compose("train", [*fixed, *HARDLY_TRAINED, *overrides, *(QUICK if effort.quick else ())])
    if "demo" in cfg.objectives:
        view = style_config(cfg, "demo")
        train_reward(view, train_clone(view, make_demonstrations(view)))
        cfg.objectives.demo.reward.path = str(stage_directory(view, *STAGES) / "reward.pt")
    return cfg


def trainer_of(cfg: DictConfig) -> Trainer:
    """The trainer that ``morlnav-train`` would run."""
    directory = Path(tempfile.mkdtemp(dir=_scratch().name))
    torch.manual_seed(cfg.seed)
    return make_trainer(cfg, directory, TensorboardCSVLogger("logs", directory))


def filled_trainer(cfg: DictConfig, frames: int) -> tuple[Trainer, Iterator[TensorDictBase]]:
    """A trainer with at least ``frames`` transitions of random driving in its replay buffer, and its next batches."""
    cfg.trainer.random_frames = frames
    trainer = trainer_of(cfg)
    trainer._setup_hook()
    batches = iter(trainer.collector)
    while len(trainer.replay_buffer) < frames:
        trainer._process_batch_hook(next(batches))
    return trainer, batches
