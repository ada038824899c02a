"""``morlnav-record FOLDER``: demonstrate by driving the robot, or import what others drove."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tensordict import TensorDict

from morlnav.cli import composed, folder, one_sentence_errors, quiet
from morlnav.config import build, check, plain
from morlnav.navigation.demonstrations import (
    Reading,
    from_minari,
    import_demonstrations,
    load_demonstrations,
)
from morlnav.navigation.demonstrations.drive import Recorder, add_demonstrations
from morlnav.navigation.demonstrations.folder import check_world
from morlnav.navigation.demonstrations.repeats import new_episodes
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.world import World

SEPARATORS = {"tab": "\t", "\\t": "\t", "space": " ", "comma": ",", "semicolon": ";"}


def drive(env: NavigationEnv, folder: Path, seed: int, size: tuple[int, int]) -> int:
    """Open a window to drive in, and add what arrives to a folder.

    Args:
        env: whose world and scenes are driven in.
        folder: of demonstrations.
        seed: of the scenes.
        size: of the window in pixels.

    Returns:
        The number of demonstrations in the folder; 0 if nothing was demonstrated.

    Raises:
        ValueError: without pygame.
    """
    try:
        from morlnav.navigation.demonstrations.window import SceneWindow
    except ImportError as error:
        raise ValueError("morlnav-record draws with pygame; install it with: pip install 'morlnav[record]'") from error
    total = 0

    def keep(episode: TensorDict) -> None:
        nonlocal total
        total = add_demonstrations(episode, folder, "driven by hand", env.world)

    window = SceneWindow(env.world, size)
    try:
        Recorder(env.world, env.scenes, keep, window, seed).run()
    finally:
        window.close()
    return total


def _refuse_other(folder: Path, world: World) -> None:
    """Refuse a folder of anything but demonstrations of this world."""
    if folder.exists() and any(folder.iterdir()):
        load_demonstrations(folder)
        check_world(folder, world)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="morlnav-record", description=__doc__.split(": ", 1)[1])
    parser.add_argument("folder", type=folder, metavar="FOLDER", help="of demonstrations; new ones are added")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="as of morlnav-train, of env")
    parser.add_argument("--seed", type=int, help="of the scenes (default: 0)")
    parser.add_argument("--size", type=int, nargs=2, help="of the window in pixels (default: 1000 700)")
    read = parser.add_argument_group("import", "What a file does not tell, or tells in words of its own.")
    several = {"nargs": "+", "action": "extend"}
    read.add_argument("--import", dest="files", **several, metavar="FILE", help="tables, .npz, ROS bags, minari:NAME")
    read.add_argument("--columns", **several, metavar="NAME=COLUMN", help="such as time=stamp x=px episode=trial")
    read.add_argument("--units", **several, metavar="NAME=UNIT", help="such as time=ms length=mm angle=deg goal_x=cm")
    read.add_argument("--names", nargs="+", metavar="NAME", help="of all columns, for a text without a header")
    read.add_argument("--separator", help="between fields: , ; tab space; by default as the header says")
    read.add_argument("--decimal", choices=[".", ","], help="sign; by default as the cells say")
    read.add_argument("--rate", type=float, help="rows or frames per second, where no times are told")
    read.add_argument("--heading", choices=["motion", "clockwise", "compass"], help="where it comes from, or counts to")
    read.add_argument("--goal", nargs="+", metavar=("X", "Y"), help="in metres, or `end`: where the drive ends")
    read.add_argument("--human", nargs="+", metavar=("X", "Y"), help="in metres, or `scan`: where scans see one")
    read.add_argument("--robot", metavar="ID", help="of several tracks, the one that drives")
    read.add_argument("--person", metavar="ID", help="of several tracks, the one that stands in the way")
    read.add_argument("--max-gap", type=float, help="longest time without a row, in s (default: 1)")
    read.add_argument("--tolerance", type=float, help="how far the robot may get from the path, in m (default: 0.2)")
    read.add_argument("--good-only", action="store_true", default=None, help="leave out episodes that cannot be driven")
    return parser


def _place(words: Sequence[str] | None, name: str, word: str) -> Any:
    """``X Y`` as two numbers, or a word in their place."""
    if words is None or words == [word]:
        return words and word
    try:
        x, y = map(float, words)
    except ValueError:
        raise ValueError(f"--{name} takes two numbers or {word}, got {' '.join(words)}.") from None
    return x, y


def _pairs(words: Sequence[str] | None, name: str) -> dict[str, str]:
    pairs = [word.partition("=") for word in words or ()]
    if wrong := [word for word, equals, value in pairs if not equals or not value]:
        raise ValueError(f"--{name} takes NAME=VALUE, got {wrong[0]}.")
    keys = [key for key, _, _ in pairs]
    if twice := [key for key in keys if keys.count(key) > 1]:
        raise ValueError(f"--{name} tells {twice[0]} twice.")
    return {key: value for key, _, value in pairs}


def _reading(args: argparse.Namespace) -> Reading:
    as_they_are = ("names", "decimal", "rate", "heading", "robot", "person", "max_gap")
    given = {name: getattr(args, name) for name in as_they_are}
    return Reading(
        columns=_pairs(args.columns, "columns"),
        units=_pairs(args.units, "units"),
        separator=SEPARATORS.get(args.separator, args.separator),
        goal=_place(args.goal, "goal", "end"),
        human=_place(args.human, "human", "scan"),
        **{name: value for name, value in given.items() if value is not None},
    )


def main() -> None:
    """Entry point."""
    quiet()
    parser = _parser()
    args = parser.parse_intermixed_args()
    if args.seed is not None and args.seed < 0:
        parser.error("--seed must not be negative")
    if args.files and (args.seed, args.size) != (None, None):
        parser.error("--seed and --size are about driving by hand; leave them out beside --import")
    with one_sentence_errors(own_classes=True):
        files = [word for word in args.files or () if "=" not in word or Path(word).exists()]
        overrides = [*args.overrides, *(word for word in args.files or () if word not in files)]
        cfg = composed(overrides)
        if other := [word for word in overrides if not re.match(r"[+~]*(env|world)\b", word)]:
            raise ValueError(f"{other[0]} changes no recording, but for env and world nothing does.")
        node = plain(cfg.env)
        check(node, "env", ("seed",), NavigationEnv)
        env = build(node | {"num_envs": 1}, "env", seed=args.seed or 0).eval()
        _refuse_other(args.folder, env.world)  # before anybody drives, and anything is read
        if files:
            how = {"tolerance": args.tolerance, "good_only": args.good_only}
            how = {name: value for name, value in how.items() if value is not None}
            sets = [file.removeprefix("minari:") for file in files if file.startswith("minari:")]
            reading = _reading(args)
            if len(sets) == len(files) and (how or reading != Reading()):
                raise ValueError("Minari data sets tell what is what; leave the options of import out.")
            parts = [from_minari(name, env.world) for name in sets]
            if len(sets) < len(files):
                tables = [file for file in files if not file.startswith("minari:")]
                parts.append(import_demonstrations(tables, reading=reading, world=env.world, **how))
            data, left = new_episodes(parts, args.folder, bool(args.good_only))
            if left:
                print(f"{left} episode{'s' * (left > 1)} left out, held by {args.folder} already or told twice.")
            total = add_demonstrations(data, args.folder, ", ".join(Path(file).name for file in files), env.world)
        else:
            settings = set(vars(args)) - {"folder", "overrides", "seed", "size", "files"}
            if given := [name for name in sorted(settings) if getattr(args, name) is not None]:
                raise ValueError(f"--{given[0].replace('_', '-')} says how files are read; name them with --import.")
            total = drive(env, args.folder, args.seed or 0, tuple(args.size or (1000, 700)))
        held = f"{args.folder} holds {total} demonstration{'s' * (total > 1)}."
        print(held if total else "Nothing was demonstrated.")


if __name__ == "__main__":
    main()
