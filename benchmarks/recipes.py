"""Trainings of ``morlnav-train``'s recipes, composed and wired as that command does it, ready to be measured."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.trainers.trainers import Trainer

from benchmarks.timing import Effort
from morlnav import cli
from morlnav.config import supply
from morlnav.runs import make_training
from morlnav.trainers import live_objects

ANALYTICAL = "objectives=[baseline,distance,efficiency]"
NEVER = 2**62
UNDISTURBED = (
    "trainer.progress_bar=false",
    f"trainer.checkpoint_interval={NEVER}",
    f"hooks.evaluate.interval={NEVER}",
    f"hooks.fit_interpolator.interval={NEVER}",
)
HARDLY_TRAINED = (
    "rewards.num=8",
    "rewards.audit=null",
    "rewards.clone.fit.steps=1",
    "rewards.ranking.levels=[0.0,0.9]",
    "rewards.ranking.episodes=2",
    "rewards.ranking.normalise=false",
    "rewards.ranking.batch_size=4",
    "rewards.ranking.fit.steps=1",
)
"""Clone and reward model have their full size but know nothing, which costs a step as much."""

QUICK = (
    ANALYTICAL,
    *("actor.num_cells=32", "critic.num_cells=32", "replay.storage.max_size=4096", "replay.batch_size=32"),
    *("env.num_envs=16", "collector.frames_per_batch=16", "trainer.optim_steps_per_batch=2"),
)


@cache
def _scratch() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="morlnav-benchmark-")


def composed(*overrides: str) -> DictConfig:
    """The config of ``morlnav-train OVERRIDES``, without evaluations on the way and checkpoints.

    >>> composed("trainer.optim_steps_per_batch=3").trainer.optim_steps_per_batch
    3
    """
    return cli.composed([*UNDISTURBED, *overrides])


def recipe(effort: Effort, *overrides: str) -> DictConfig:
    """The same with rewards that are learned at once, on the effort's device and small for a quick try."""
    fixed = (f"device={torch.device(effort.device)}", f"cache={_scratch().name}/cache")
    return composed(*fixed, *HARDLY_TRAINED, *overrides, *(QUICK if effort.quick else ()))


def trainer_of(cfg: DictConfig) -> Trainer:
    """The trainer that ``morlnav-train`` would run, in a folder that goes with this process."""
    directory = Path(tempfile.mkdtemp(dir=_scratch().name))
    training = make_training(cfg)
    logger = training.make_logger(directory)
    return training.make_trainer(directory, training.learn_rewards(directory), logger)


def filled_trainer(cfg: DictConfig, frames: int) -> tuple[Trainer, Iterator[TensorDictBase]]:
    """A trainer with at least ``frames`` transitions of random driving in its replay buffer, and its next batches."""
    cfg.collector.init_random_frames = frames
    trainer = trainer_of(cfg)
    trainer._setup_hook()
    batches = iter(trainer.collector)
    while len(trainer.replay_buffer) < frames:
        trainer._process_batch_hook(next(batches))
    return trainer, batches


@dataclass
class Networks:
    """A config's networks, untrained.

    Attributes:
        actor: maps observations and preferences to actions.
        critics: two modules from observations, preferences and actions to vectors of values.
        num_rewards: entries of the reward vector.
        num_objectives: entries of λ.
        limits: least and largest action, both ``[A]``.
    """

    actor: nn.Module
    critics: list[nn.Module]
    num_rewards: int
    num_objectives: int
    limits: tuple[Tensor, Tensor]


def networks(cfg: DictConfig, all_tuneable: bool = False) -> Networks:
    """The networks that ``morlnav-train`` would train.

    Args:
        cfg: from :func:`recipe`.
        all_tuneable: the preference has an entry for every reward, for learners that know no static ones.
    """
    training = make_training(cfg)
    rewards = {} if training.rewards is None else training.pipeline().untrained()
    live = live_objects(training.make_env({name: reward.transform for name, reward in rewards.items()}, num_envs=1))
    if all_tuneable:
        live["num_objectives"] = live["num_rewards"]
    actor, *critics = (supply(part, **live).to(cfg.device) for part in (training.actor, *2 * [training.critic]))
    limits = tuple(torch.tensor(live[name], device=cfg.device) for name in ("action_low", "action_high"))
    return Networks(actor, critics, live["num_rewards"], live["num_objectives"], limits)
