"""``morlnav-evaluate RUN_DIR``: measure a trained policy over all preferences on episodes it never saw."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import torch

from morlnav.cli import composed, folder, one_sentence_errors, quiet, set_threads, writable
from morlnav.config import plain
from morlnav.deployment.context import ContextPolicy, load_contexts
from morlnav.navigation.evaluation import NavigationEvaluation, episode_metrics, summarise
from morlnav.navigation.world import Scene
from morlnav.runs import Run, make_training

CHANGES = ("episodes", "steps", "seed", "reference", "plan")
"""Values of a run's evaluation that the command line may change."""

WITHOUT = {
    "animate": ("contexts", "route", "output", "steps", "reference", "plan"),
    "contexts": ("steps", "reference", "plan"),
}
"""Options that another one leaves without a meaning."""


def use_recorded_scenes(run: Run, folder: Path) -> None:
    """Let a run be evaluated where somebody was recorded: with their start, goal, human and boxes.

    Args:
        run: a finished run of a navigating policy.
        folder: of demonstrations, as ``morlnav-record`` writes it.

    Raises:
        FileNotFoundError: if the folder holds no demonstrations.
        ValueError: if they are damaged, or the run's robot could not drive there.
    """
    from morlnav.navigation.demonstrations import load_demonstrations  # brings the audit along

    data = load_demonstrations(folder)
    try:
        navigation_of(run).use(Scene.from_tensordict(data["scene"][data["step"] == 0]))
    except ValueError as error:
        raise ValueError(f"{folder}: {error}") from error


def use_world(run: Run, name: str) -> None:
    """Let a run be evaluated in another world than it was trained in, with the robot, lidar and times of its own.

    Args:
        run: a finished run of a navigating policy.
        name: of a world in the config group.

    Raises:
        ValueError: for a policy of another kind, and an unknown world.
    """
    navigation_of(run)
    world, env = plain(composed([f"world={name}"]).env.world), run.config["env"]
    own = {key: value for key, value in (env.get("world") or {}).items() if key in world and key != "_target_"}
    config = run.config | {"env": env | {"world": world | own}}
    run.evaluation = make_training(config).make_evaluation(run.learned)  # rewards belong to the run's own world


def evaluate_run(run: Run, output: Path | None = None) -> Path:
    """Evaluate the policy of a run, and write tables and figures.

    Args:
        run: a finished run.
        output: where results go; ``evaluation`` in the run's directory by default.

    Returns:
        Where they are.
    """
    output = writable(output or run.directory / "evaluation")
    run.evaluation.report(run.policy, output)
    return output


def evaluate_route(
    run: Run, contexts: Path, route: Mapping[float, str], output: Path | None = None, time_constant: float = 1.0
) -> Path:
    """Evaluate the policy in the style of every room, and on a route where the style changes in mid-episode.

    Args:
        run: a finished run of a navigating policy.
        contexts: file for :func:`~morlnav.deployment.context.load_contexts`.
        route: room by the second in which it is entered, the first at 0.
        output: where ``rooms.csv`` goes; ``evaluation`` in the run's directory by default.
        time_constant: of the change in seconds.

    Returns:
        The file: one row per room, one for the route.
    """
    output, evaluation = writable(output or run.directory / "evaluation"), navigation_of(run)
    world = evaluation.env.world
    rooms = load_contexts(contexts, run.policy.objectives)
    robot = ContextPolicy(run.policy, rooms, time_constant=time_constant, step_time=world.step_time)
    routes = [*({0.0: room} for room in rooms), route]
    schedules = torch.stack([robot.schedule(leg, evaluation.max_steps) for leg in routes])
    scenes = evaluation.scenes()
    rollouts = evaluation.drive(run.policy, scenes, schedules)
    metrics = episode_metrics(rollouts, evaluation.rewards, world=world, references=evaluation.references(scenes))
    summary = summarise(metrics)
    label = ", ".join(f"{room} from {time:g} s" for time, room in sorted(route.items()))
    summary.insert(0, "room", [*rooms, label])
    output.mkdir(parents=True, exist_ok=True)
    summary.to_csv(output / "rooms.csv", index=False)
    return output / "rooms.csv"


def animate_run(run: Run, file: Path, scene: int = 0, steps: int = 2) -> None:
    """Show the knob in motion, four times as fast: several preferences at once, in one scene that the policy never saw.

    Args:
        run: a finished run of a navigating policy.
        file: the animation, ``.gif``.
        scene: which of the evaluation scenes.
        steps: of every pairwise interpolation of preferences.

    Raises:
        ValueError: for another kind of file, or a scene that the evaluation does not have.
    """
    if file.suffix.lower() != ".gif":
        raise ValueError(f"The animation is a GIF; give it a name such as {file.with_suffix('.gif')}, not {file}.")
    if file.is_dir():
        raise IsADirectoryError(f"{file} is a folder; name a file in it.")
    writable(file.parent)
    from morlnav.navigation.record.animation import animate_rollouts  # loads matplotlib

    evaluation = navigation_of(run)
    if not 0 <= scene < evaluation.episodes:
        raise ValueError(f"The scene must be an index below evaluation.episodes={evaluation.episodes}, got {scene}.")
    preferences = evaluation.preferences(steps)
    rollouts = evaluation.drive(run.policy, evaluation.scenes()[scene : scene + 1], preferences)
    file.parent.mkdir(parents=True, exist_ok=True)
    world = evaluation.env.world
    radii = {"human_radius": world.human_radius, "robot_radius": world.robot.radius, "step_time": world.step_time}
    animate_rollouts(rollouts, evaluation.objectives, stride=2, **radii).save(file, writer="pillow", dpi=110, fps=10)


def navigation_of(run: Run) -> NavigationEvaluation:
    """The evaluation of a navigating policy.

    Raises:
        ValueError: for a policy of another kind.
    """
    if not isinstance(run.evaluation, NavigationEvaluation):
        raise ValueError(f"{run.directory} holds no navigating policy, which rooms, scenes and animations are for.")
    return run.evaluation


def parse_stop(word: str) -> tuple[float, str]:
    """The second and the room of a stop on a route.

    >>> parse_stop("6:kitchen")
    (6.0, 'kitchen')
    """
    second, _, room = word.partition(":")
    with suppress(ValueError):
        if room:
            return float(second), room
    raise argparse.ArgumentTypeError(f"{word} is no SECOND:ROOM, such as 6:kitchen.")


def main() -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-evaluate", description=__doc__.split(": ", 1)[1])
    parser.add_argument("run", type=Path, metavar="RUN_DIR", help="a run directory of morlnav-train")
    parser.add_argument("--episodes", type=int, help="per preference (default: the run's config)")
    parser.add_argument("--steps", type=int, help="steps of every pairwise interpolation of preferences")
    parser.add_argument("--seed", type=int, help="seed of the episodes")
    parser.add_argument("--reference", type=float, nargs="+", help="reference point of the hypervolume, by reward")
    parser.add_argument(
        "--plan",
        action="store_const",
        const=True,
        help="tell regrets from the best path under each learned reward, too, planned in every scene (takes minutes)",
    )
    parser.add_argument("--scenes", type=Path, metavar="FOLDER", help="drive in the scenes of these demonstrations")
    parser.add_argument("--world", help="drive in this one of the config group (default: the run's own)")
    parser.add_argument(
        "--output",
        type=folder,
        help="where results go (default: RUN_DIR/evaluation, and in it WORLD with --world, FOLDER with --scenes)",
    )
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
    parser.add_argument("--scene", type=int, help="with --animate: which of the evaluation scenes (default: 0)")
    args = parser.parse_args()
    if (args.contexts is None) != (args.route is None):
        parser.error("--contexts and --route go together")
    if args.scene is not None and args.animate is None:
        parser.error("--scene belongs to --animate")
    for option, others in WITHOUT.items():
        if getattr(args, option) is not None:
            for other in (other for other in others if getattr(args, other) is not None):
                parser.error(f"--{other} changes nothing beside --{option}; leave it out")
    if len(dict(args.route or ())) < len(args.route or ()):
        parser.error("--route enters two rooms at once; give each second one room")
    if args.scenes is not None and (args.episodes, args.seed) != (None, None):
        parser.error("--scenes are as many as were recorded; leave out --episodes and --seed")
    with one_sentence_errors(own_classes=True):
        set_threads(args.threads)
        run = Run(args.run, args.trust, {name: getattr(args, name) for name in CHANGES})
        place = args.run / "evaluation"
        if args.world is not None:
            use_world(run, args.world)
            place /= args.world
        if args.scenes is not None:
            use_recorded_scenes(run, args.scenes)
            place /= args.scenes.resolve().name
        args.output = args.output or place
        if args.animate is not None:
            animate_run(run, args.animate, args.scene or 0)
            print(f"The animation is in {args.animate}")
        elif args.contexts is not None:
            rooms = evaluate_route(run, args.contexts, dict(args.route), args.output)
            navigation_of(run).show_rooms(rooms)
            print(f"The table is in {rooms}")
        else:
            output = evaluate_run(run, args.output)
            run.evaluation.show(output, run.directory)
            print(f"Tables and figures are in {output}")


if __name__ == "__main__":
    main()
