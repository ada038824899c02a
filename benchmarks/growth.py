"""Cost as the work grows: more objectives, obstacles and seeds; more environments are in the simulation's group."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import torch
from omegaconf import DictConfig, open_dict
from torch import Tensor

from benchmarks.learner import EXACT, PLAIN, SHAPES, minimal, optimisation, random_rows
from benchmarks.peers.stacked_td3 import StackedTD3
from benchmarks.recipes import ANALYTICAL, Networks, networks, recipe
from benchmarks.simulation import drive, engines
from benchmarks.timing import Contender, Effort, Row, race
from morlnav.cli import keep_freed_memory
from morlnav.navigation.world import SceneSampler

TITLE = "Cost as the work grows"
NOTES = """Updates as in the learner's *plain* row with more objectives; steps of 64 environments with more boxes;
hand-written updates (*minimal* in the learner's group) of several seeds, one after the other, with parameters
stacked under `vmap`, and in processes of one thread each, as many as threads, as a parallel sweep runs them."""

OBJECTIVES, OBSTACLES, ENVIRONMENTS, SEEDS = (2, 4, 8, 16), (3, 10, 30, 100), 64, (1, 2, 4, 8, 16)
TURNS = 10  # of a process per call


def measure(effort: Effort) -> list[Row]:
    """Measure every size after the other."""
    frames = 256 if effort.quick else 10_000
    rows = []
    for count in OBJECTIVES[:2] if effort.quick else OBJECTIVES:
        cfg = with_objectives(recipe(effort, ANALYTICAL, *SHAPES, *PLAIN, EXACT), count)
        learner = Contender("morlnav, plain", partial(optimisation, cfg, frames), cfg.trainer.optim_steps_per_batch)
        rows += race("growth", f"{count} objectives", "updates/s", [learner], effort, size=count)
    for count in OBSTACLES[:2] if effort.quick else OBSTACLES:
        contenders = [
            Contender(
                f"{name} engine",
                partial(drive, world, ENVIRONMENTS, SceneSampler(num_boxes=count, **_room_for(count))),
                ENVIRONMENTS,
            )
            for name, world in engines(effort.device).items()
        ]
        rows += race("growth", f"{count} boxes", "steps/s", contenders, effort, size=count)
    for count in SEEDS[:2] if effort.quick else SEEDS:
        contenders = [
            Contender("one seed after the other", partial(_one_by_one, effort, count), count, ours=False),
            Contender("stacked under vmap", partial(_stacked, effort, count), count, ours=False),
        ]
        if 1 < torch.get_num_threads() <= count and effort.device == "cpu":
            contenders.append(
                Contender("in processes", partial(_in_processes, effort, count), count * TURNS, ours=False)
            )
        rows += race("growth", f"{count} seeds", "updates/s", contenders, effort, size=count)
    return rows


def _learners(effort: Effort, count: int) -> tuple[list[Networks], dict[str, Tensor]]:
    """Networks of every seed, and the transitions that all learn from."""
    cfg = recipe(effort, ANALYTICAL, *SHAPES, *PLAIN, EXACT)
    parts = [networks(cfg) for _ in range(count)]
    return parts, random_rows(10_000, parts[0].num_rewards, effort.device)


def _one_by_one(effort: Effort, count: int) -> Callable[[], object]:
    parts, rows = _learners(effort, count)
    learners = [minimal(one, rows) for one in parts]
    return lambda: [learner.step() for learner in learners]


def _stacked(effort: Effort, count: int) -> Callable[[], object]:
    parts, rows = _learners(effort, count)
    actors, critics = [one.actor for one in parts], [one.critics for one in parts]
    return StackedTD3(actors, critics, rows, *parts[0].limits, parts[0].num_objectives).step


def _in_processes(effort: Effort, count: int) -> Callable[[], object]:
    workers = torch.get_num_threads()
    shares = [count // workers + (worker < count % workers) for worker in range(workers)]
    pools = [ProcessPoolExecutor(1, get_context("spawn"), _begin, (effort, share)) for share in shares]
    return lambda: [turn.result() for turn in [pool.submit(_take_turns) for pool in pools]]


def _begin(effort: Effort, count: int) -> None:
    global _step  # of this process
    torch.set_num_threads(1)
    keep_freed_memory()
    _step = _one_by_one(effort, count)


def _take_turns() -> None:
    for _ in range(TURNS):
        _step()


def _room_for(boxes: int) -> dict[str, object]:
    """Many boxes are small and lie in a wider band, so that there is room for them."""
    return {"box_half_side": (0.1, 0.2), "band": 6.0} if boxes > 10 else {}


def with_objectives(cfg: DictConfig, count: int) -> DictConfig:
    """The config with ``count`` objectives: the baseline, distance, efficiency, and copies of the last."""
    terms = cfg.env.objectives
    names = list(terms)
    with open_dict(cfg):
        cfg.env.objectives = {name: terms[name] for name in names[:count]} | {
            f"objective_{index}": terms[names[-1]] for index in range(len(names), count)
        }
        cfg.loss.scalarisation.update({"scale": 1.0, "tie_break": 0.0})  # those of the recipe name its own objectives
        cfg.hooks.discount.end = 0.99
    return cfg
