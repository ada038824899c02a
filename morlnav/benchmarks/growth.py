"""Cost as the work grows: more objectives, obstacles and seeds; more environments are in the simulation's group."""

from __future__ import annotations

from functools import partial

from omegaconf import DictConfig, open_dict

from morlnav.benchmarks.learner import EXACT, PLAIN, SHAPES, optimisation
from morlnav.benchmarks.recipes import ANALYTICAL, recipe
from morlnav.benchmarks.simulation import drive, engines
from morlnav.benchmarks.timing import Contender, Effort, Row, race
from morlnav.world import SceneSampler

TITLE = "Cost as the work grows"
NOTES = """Updates as in the learner's *plain* row with more objectives; steps of 64 environments with more boxes."""

OBJECTIVES, OBSTACLES, ENVIRONMENTS = (2, 4, 8, 16), (3, 10, 30, 100), 64


def measure(effort: Effort) -> list[Row]:
    """Measure every size after the other."""
    frames = 1000 if effort.quick else 10_000
    rows = []
    for count in OBJECTIVES[:2] if effort.quick else OBJECTIVES:
        cfg = with_objectives(recipe(effort, ANALYTICAL, *SHAPES, *PLAIN, EXACT, "evaluation.during.steps=1"), count)
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
    return [*rows, Row("growth", "1…16 seeds", "morlnav", "updates/s", note="not available: seeds train one by one")]


def _room_for(boxes: int) -> dict[str, object]:
    """Many boxes are small and lie in a wider band, so that there is room for them."""
    return {"box_half_side": (0.1, 0.2), "band": 6.0} if boxes > 10 else {}


def with_objectives(cfg: DictConfig, count: int) -> DictConfig:
    """The config with ``count`` objectives: the baseline, distance, efficiency, and copies of the last."""
    names = list(cfg.objectives)
    with open_dict(cfg):
        cfg.objectives = {name: cfg.objectives[name] for name in names[:count]} | {
            f"objective_{index}": cfg.objectives[names[-1]] for index in range(len(names), count)
        }
    return cfg
