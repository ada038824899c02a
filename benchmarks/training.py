"""Whole trainings: environment steps and updates per second, as they take turns."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import gymnasium
import torch
from omegaconf import DictConfig

from benchmarks.peers import libraries
from benchmarks.recipes import filled_trainer, recipe
from benchmarks.timing import Contender, Effort, Row, race
from morlnav.navigation.envs import ENV_ID

TITLE = "Whole training: driving and learning in turns"
NOTES = """Every row collects environment steps and makes the updates that belong to them: morlnav's recipes in the
loop of `morlnav-train`, without the evaluations on the way (every 40,000 steps) and checkpoints; CAPQL as in
its own `train`, with its default networks (2×256) and batches (128), on our Gymnasium environment. Rates of environment
steps are not rates of learning: the recipes differ in the number of updates per step, which is given. On a CPU the
default recipe then drives and learns once more beside a process that never rests, with one thread and with two."""

RECIPES = {"morlnav, default recipe": (), "the paper's literal recipe": ("recipe=paper",)}


def measure(effort: Effort) -> list[Row]:
    """Race the recipes, and CAPQL."""
    frames = 256 if effort.quick else 1000
    configs = {name: recipe(effort, *overrides) for name, overrides in RECIPES.items()}
    ratios = {name: cfg.trainer.optim_steps_per_batch / cfg.collector.frames_per_batch for name, cfg in configs.items()}
    contenders = [
        Contender(
            name,
            partial(training, cfg, frames),
            cfg.collector.frames_per_batch,
            f"{cfg.env.num_envs} environments, updates per step: {ratios[name]:g}",
        )
        for name, cfg in configs.items()
    ]
    name, note = "morl-baselines CAPQL", "1 environment, updates per step: 1"
    ratios[name] = 1.0
    learner = partial(libraries.capql_training, gymnasium.make(ENV_ID), effort.device)
    contenders.append(Contender(name, learner, note=note, peer=True))
    rows = race("training", "environment steps", "steps/s", contenders, effort)
    rows += [
        replace(row, case="updates", unit="updates/s", values=[ratios[row.name] * rate for rate in row.values])
        for row in rows
    ]
    if effort.device == "cpu":
        rows += _beside_a_busy_process(configs["morlnav, default recipe"], frames, effort)
    return rows


def _beside_a_busy_process(cfg: DictConfig, filled: int, effort: Effort) -> list[Row]:
    def with_threads(number: int) -> Callable[[], object]:
        step = training(cfg, filled)

        def run() -> None:
            torch.set_num_threads(number)
            step()

        return run

    names, frames = ("morlnav, 1 thread", "morlnav, 2 threads"), cfg.collector.frames_per_batch
    contenders = [Contender(name, partial(with_threads, number), frames) for number, name in enumerate(names, 1)]
    threads = torch.get_num_threads()
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as busy:
        try:
            return race("training", "environment steps beside a busy process", "steps/s", contenders, effort)
        finally:
            busy.kill()
            torch.set_num_threads(threads)


def training(cfg: DictConfig, frames: int) -> Callable[[], object]:
    """One pass of the trainer's loop: a batch of environment steps, and the updates that follow it."""
    trainer, batches = filled_trainer(cfg, frames)

    def step() -> None:
        batch = trainer._process_batch_hook(next(batches))
        trainer.collected_frames += batch.numel()
        trainer._pre_steps_log_hook(batch)
        trainer.optim_steps(batch)
        trainer._post_steps_hook()
        trainer._post_steps_log_hook(batch)

    return step
