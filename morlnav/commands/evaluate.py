"""``morlnav-evaluate RUN_DIR``: measure a trained policy over all preferences on scenes it never saw."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from morlnav.cli import one_sentence_errors, quiet, set_threads
from morlnav.data import preference_edges
from morlnav.deployment.context import ContextPolicy, load_contexts
from morlnav.deployment.policy import Policy, load, load_config
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.evaluation import (
    Rollouts,
    episode_metrics,
    evaluate_policy,
    evaluation_scenes,
    markdown_table,
    overall,
    read_reference,
    reference_from_bounds,
    summarise,
    write_report,
)
from morlnav.navigation.evaluation.report import sentences
from morlnav.record.tables import audit_line, make_console, print_summary
from morlnav.trainers.builders import make_base_env
from morlnav.trainers.styles import demonstrated_objectives, demonstrated_paths, style_directory


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
    policy, cfg, env = _load(directory, trust, changes)
    rollouts = _drive(policy, cfg, env, preference_edges(len(env.objectives), cfg.evaluation.steps))
    return write_report(
        rollouts,
        output or directory / "evaluation",
        rewards=tuple(env.rewards),
        world=env.world,
        references=demonstrated_paths(cfg, rollouts.scene[0], env.world, directory),
        reference_point=hypervolume_reference(cfg, env),
    )


def hypervolume_reference(cfg: DictConfig, env: NavigationEnv) -> Tensor:
    """The reference point ``[m]`` of a run: what ``evaluation.reference`` says, the rest from the rewards' bounds.

    Raises:
        ValueError: if the config's numbers or names do not fit the objectives.
    """
    given = cfg.evaluation.get("reference")
    given = OmegaConf.to_container(given, resolve=True) if OmegaConf.is_config(given) else given
    return read_reference(given, tuple(env.rewards), reference_from_bounds(env.reward_bounds, cfg.env.max_steps))


def evaluate_route(
    directory: Path,
    contexts: Path,
    route: Mapping[float, str],
    output: Path | None = None,
    trust: bool = False,
    time_constant: float = 1.0,
    **changes: int,
) -> str:
    """Evaluate the policy in the style of every room, and on a route where the style changes in mid-episode.

    Args:
        directory: a run directory.
        contexts: file for :func:`~morlnav.deployment.context.load_contexts`.
        route: room by the second in which it is entered, the first at 0.
        output: where ``rooms.csv`` goes; ``directory/evaluation`` by default.
        trust: build classes from outside the package that the run's config names.
        time_constant: of the change in seconds.
        changes: as for :func:`evaluate_run`.

    Returns:
        A Markdown table: one row per room, one for the route.
    """
    policy, cfg, env = _load(directory, trust, changes)
    rooms = load_contexts(contexts, policy.objectives)
    robot = ContextPolicy(policy, rooms, time_constant=time_constant, step_time=env.world.step_time)
    routes = [*({0.0: room} for room in rooms), route]
    rollouts = _drive(policy, cfg, env, torch.stack([robot.schedule(leg, cfg.env.max_steps) for leg in routes]))
    references = demonstrated_paths(cfg, rollouts.scene[0], env.world, directory)
    summary = summarise(episode_metrics(rollouts, tuple(env.rewards), world=env.world, references=references))
    label = ", ".join(f"{room} from {time:g} s" for time, room in sorted(route.items()))
    summary.insert(0, "room", [*rooms, label])
    output = output or directory / "evaluation"
    output.mkdir(parents=True, exist_ok=True)
    summary.to_csv(output / "rooms.csv", index=False)
    return markdown_table(summary, ["room"])


def show_evaluation(directory: Path, output: Path | None = None) -> None:
    """Print what an evaluation found, in a few lines that fit a terminal.

    Args:
        directory: of the run, which keeps the audits of its rewards.
        output: where its evaluation lies; ``directory/evaluation`` by default.
    """
    output, console = output or directory / "evaluation", make_console()
    episodes, summary, faithful, front = (
        pd.read_csv(output / f"{name}.csv") for name in ("episodes", "summary", "fidelity", "front")
    )
    demonstrated = demonstrated_objectives(load_config(directory))
    print_summary(summary, overall(episodes, resamples=2), demonstrated=demonstrated, console=console)
    audits = [audit_line(style_directory(directory, name) / "audit", name) for name in demonstrated]
    for line in [*sentences(summary, faithful, front), *filter(None, audits)]:
        console.print(line)
    console.print(f"All rows and columns are in {output / 'table.md'}", soft_wrap=True)


def animate_run(
    directory: Path, file: Path, scene: int = 0, steps: int = 2, trust: bool = False, **changes: int
) -> None:
    """Show the knob in motion, four times as fast: several preferences at once, in one scene that the policy never saw.

    Args:
        directory: a run directory.
        file: the animation, ``.gif``.
        scene: which of the evaluation scenes.
        steps: of every pairwise interpolation of preferences.
        trust: build classes from outside the package that the run's config names.
        changes: as for :func:`evaluate_run`.

    Raises:
        ValueError: for another kind of file, or a scene that the evaluation does not have.
    """
    if file.suffix.lower() != ".gif":
        raise ValueError(f"The animation is a GIF; give it a name such as {file.with_suffix('.gif')}, not {file}.")
    from morlnav.record.animation import animate_rollouts  # loads matplotlib

    policy, cfg, env = _load(directory, trust, changes)
    if not 0 <= scene < cfg.evaluation.episodes:
        raise ValueError(
            f"The scene must be an index below evaluation.episodes={cfg.evaluation.episodes}, got {scene}."
        )
    rollouts = _drive(policy, cfg, env, preference_edges(len(env.objectives), steps), slice(scene, scene + 1))
    file.parent.mkdir(parents=True, exist_ok=True)
    world = env.world
    radii = {"human_radius": world.human_radius, "robot_radius": world.robot.radius, "step_time": world.step_time}
    animate_rollouts(rollouts, env.objectives, stride=2, **radii).save(file, writer="pillow", dpi=110, fps=10)


def _load(directory: Path, trust: bool, changes: Mapping[str, int]) -> tuple[Policy, DictConfig, NavigationEnv]:
    policy = load(directory, trust=trust)
    cfg = load_config(directory)
    cfg.evaluation = OmegaConf.merge(cfg.evaluation, changes)
    return policy, cfg, make_base_env(cfg, num_envs=1)


def _drive(
    policy: Policy, cfg: DictConfig, env: NavigationEnv, preferences: Tensor, part: slice = slice(None)
) -> Rollouts:
    return evaluate_policy(
        policy,
        evaluation_scenes(cfg.evaluation.episodes, seed=cfg.evaluation.seed, sampler=env.scenes)[part],
        preferences,
        world=env.world,
        objectives=env.rewards,
        observe_human=env.observe_human,
        max_steps=cfg.env.max_steps,
    )


def parse_stop(word: str) -> tuple[float, str]:
    """The second and the room of a stop on a route.

    >>> parse_stop("6:kitchen")
    (6.0, 'kitchen')
    """
    second, _, room = word.partition(":")
    try:
        stop = float(second), room
    except ValueError:
        stop = None
    if stop is None or not room:
        raise argparse.ArgumentTypeError(f"{word} is no SECOND:ROOM, such as 6:kitchen.")
    return stop


def main() -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-evaluate", description=__doc__.split(": ", 1)[1])
    parser.add_argument("run", type=Path, metavar="RUN_DIR", help="a run directory of morlnav-train")
    parser.add_argument("--episodes", type=int, help="scenes per preference (default: the run's config)")
    parser.add_argument("--steps", type=int, help="steps of every pairwise interpolation of preferences")
    parser.add_argument("--seed", type=int, help="seed of the evaluation scenes")
    parser.add_argument("--output", type=Path, help="where results go (default: RUN_DIR/evaluation)")
    parser.add_argument("--threads", type=int, default=1, help="threads of PyTorch (default: 1)")
    parser.add_argument("--trust", action="store_true", help="build classes from outside morlnav that the run names")
    parser.add_argument("--contexts", type=Path, metavar="FILE", help="YAML file of preferences by room")
    parser.add_argument(
        "--route",
        nargs="+",
        type=parse_stop,
        metavar="SECOND:ROOM",
        help="with --contexts: the rooms on the way, as 0:hall",
    )
    parser.add_argument("--animate", type=Path, metavar="FILE.gif", help="instead: the knob in motion in one scene")
    parser.add_argument("--scene", type=int, default=0, help="with --animate: which of the evaluation scenes")
    args = parser.parse_args()
    if (args.contexts is None) != (args.route is None):
        parser.error("--contexts and --route go together")
    changes = {name: getattr(args, name) for name in ("episodes", "steps", "seed") if getattr(args, name) is not None}
    with one_sentence_errors():
        set_threads(args.threads)
        if args.animate is not None:
            animate_run(args.run, args.animate, args.scene, trust=args.trust, **changes)
            print(f"The animation is in {args.animate}")
            return
        if args.contexts is not None:
            evaluate_route(args.run, args.contexts, dict(args.route), args.output, args.trust, **changes)
            rooms = pd.read_csv((args.output or args.run / "evaluation") / "rooms.csv")
            print_summary(rooms, label="room", demonstrated=demonstrated_objectives(load_config(args.run)))
        else:
            evaluate_run(args.run, args.output, args.trust, **changes)
            show_evaluation(args.run, args.output)
        print(f"Tables and figures are in {args.output or args.run / 'evaluation'}")


if __name__ == "__main__":
    main()
