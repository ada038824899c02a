"""``morlnav-evaluate RUN_DIR``: measure a trained policy over all preferences on scenes it never saw."""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from morlnav.cli import one_sentence_errors, quiet
from morlnav.data import preference_edges
from morlnav.evaluation import default_reference, evaluate_policy, evaluation_scenes, reference_paths, write_report
from morlnav.policy import load, load_config
from morlnav.trainers.builders import build, make_base_env
from morlnav.world import Scene, World


def evaluate_run(directory: Path, output: Path | None = None, trust: bool = False, **changes: int) -> str:
    """Evaluate the policy in a run directory and write tables and figures to ``output``.

    Args:
        directory: a run directory.
        output: where results go; ``directory/evaluation`` by default.
        trust: build classes from outside the package that the run's config names.
        changes: replace values of the config's ``evaluation`` group, such as ``episodes=20``.

    Returns:
        The readable table.
    """
    policy = load(directory, trust=trust)
    cfg: DictConfig = load_config(directory)
    cfg.evaluation = OmegaConf.merge(cfg.evaluation, changes)
    env = make_base_env(cfg, num_envs=1)
    scenes = evaluation_scenes(cfg.evaluation.episodes, seed=cfg.evaluation.seed, sampler=env.scenes)
    rollouts = evaluate_policy(
        policy,
        scenes,
        preference_edges(len(env.objectives), cfg.evaluation.steps),
        world=env.world,
        objectives=env.rewards,
        observe_human=env.observe_human,
        max_steps=cfg.env.max_steps,
    )
    output = output or directory / "evaluation"
    references = _references(cfg, scenes, env.world)
    return write_report(
        rollouts,
        output,
        rewards=tuple(env.rewards),
        world=env.world,
        references=references,
        reference_point=default_reference(len(env.rewards), len(env.objectives), cfg.env.max_steps),
    )


def _references(cfg: DictConfig, scenes: Scene, world: World) -> list[Tensor] | None:
    """Paths of the demonstrator, to measure the Fréchet distance to, if it can drive in this world."""
    demonstrator = OmegaConf.select(cfg, "demonstrations.policy")
    if demonstrator is None:
        return None
    try:
        return reference_paths(scenes, build(demonstrator), world=world, max_steps=cfg.env.max_steps)
    except ValueError as error:
        print(f"No Fréchet distances to the demonstration: {error}")
        return None


def main() -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-evaluate", description=__doc__.split(": ", 1)[1])
    parser.add_argument("run", type=Path, metavar="RUN_DIR", help="a run directory of morlnav-train")
    parser.add_argument("--episodes", type=int, help="scenes per preference (default: the run's config)")
    parser.add_argument("--steps", type=int, help="steps of every pairwise interpolation of preferences")
    parser.add_argument("--seed", type=int, help="seed of the evaluation scenes")
    parser.add_argument("--output", type=Path, help="where results go (default: RUN_DIR/evaluation)")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads(), help="threads of PyTorch")
    parser.add_argument("--trust", action="store_true", help="build classes from outside morlnav that the run names")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    changes = {name: getattr(args, name) for name in ("episodes", "steps", "seed") if getattr(args, name) is not None}
    with one_sentence_errors():
        print(evaluate_run(args.run, args.output, args.trust, **changes))
        print(f"Tables and figures are in {args.output or args.run / 'evaluation'}")


if __name__ == "__main__":
    main()
