"""``morlnav-record FOLDER``: demonstrate by driving the robot, or import what others drove."""

from __future__ import annotations

import argparse
from pathlib import Path

from tensordict import TensorDict

from morlnav.cli import composed, folder, one_sentence_errors, quiet
from morlnav.config import build, check, plain
from morlnav.navigation.demonstrations import import_demonstrations, load_demonstrations
from morlnav.navigation.demonstrations.drive import Recorder, add_demonstrations
from morlnav.navigation.envs import NavigationEnv


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
        ValueError: without pygame, or for a folder of anything else.
    """
    try:
        from morlnav.navigation.demonstrations.window import SceneWindow
    except ImportError as error:
        raise ValueError("morlnav-record draws with pygame; install it with: pip install 'morlnav[record]'") from error
    total = 0

    def keep(episode: TensorDict) -> None:
        nonlocal total
        total = add_demonstrations(episode, folder, "driven by hand")

    if folder.exists() and any(folder.iterdir()):
        load_demonstrations(folder)  # refuse a folder of anything else before somebody drives
    window = SceneWindow(env.world, size)
    try:
        Recorder(env.world, env.scenes, keep, window, seed).run()
    finally:
        window.close()
    return total


def main() -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-record", description=__doc__.split(": ", 1)[1])
    parser.add_argument("folder", type=folder, metavar="FOLDER", help="of demonstrations; new ones are added")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="as of morlnav-train, of env")
    parser.add_argument("--import", dest="file", type=Path, metavar="FILE", help="a .csv or .npz file of trajectories")
    parser.add_argument("--seed", type=int, default=0, help="of the scenes")
    parser.add_argument("--size", type=int, nargs=2, default=(1000, 700), help="of the window in pixels")
    args = parser.parse_intermixed_args()
    if args.seed < 0:
        parser.error("--seed must not be negative")
    with one_sentence_errors(own_classes=True):
        node = plain(composed(args.overrides).env)
        check(node, "env", ("seed",), NavigationEnv)
        env = build(node | {"num_envs": 1}, "env", seed=args.seed).eval()
        if args.file is not None:
            total = add_demonstrations(import_demonstrations(args.file, world=env.world), args.folder, args.file.name)
        else:
            total = drive(env, args.folder, args.seed, tuple(args.size))
        print(f"{args.folder} holds {total} demonstrations." if total else "Nothing was demonstrated.")


if __name__ == "__main__":
    main()
