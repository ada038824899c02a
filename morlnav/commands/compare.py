"""``morlnav-compare RUN_DIR FOLDER``: roll-outs of a policy in all styles, and a page that asks which drives better."""

from __future__ import annotations

import argparse
from pathlib import Path

from morlnav.cli import folder, one_sentence_errors, quiet
from morlnav.commands.evaluate import navigation_of
from morlnav.navigation.comparisons import COMPARISONS_FILE, draw_pairs, record_styles, write_page
from morlnav.navigation.demonstrations import save_demonstrations
from morlnav.runs import Run


def prepare(run: Run, folder: Path, pairs: int = 30, scenes: int = 10, steps: int = 2, seed: int = 0) -> Path:
    """Record what is to be compared, and write the page.

    Args:
        run: a finished run of a navigating policy.
        folder: receives the roll-outs as demonstrations, and ``compare.html``; it may exist if it is empty.
        pairs: to ask for.
        scenes: held-out ones to drive in.
        steps: of every pairwise interpolation of preferences.
        seed: of scenes and pairs.

    Returns:
        The page.

    Raises:
        FileExistsError: if the folder holds anything.
        ValueError: if there are not so many pairs.
    """
    if folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"{folder} is not empty; name a new folder for the roll-outs.")
    evaluation = navigation_of(run)
    preferences = evaluation.preferences(steps)
    drawn = draw_pairs(scenes, len(preferences), pairs, seed)
    env = evaluation.env
    settings = {"world": env.world, "observe_human": env.observe_human, "max_steps": evaluation.max_steps}
    data = record_styles(run.policy, evaluation.scenes(scenes, seed), preferences, **settings)
    save_demonstrations(data, folder, {"policy": str(run.directory), "preferences": preferences.tolist()}, env.world)
    write_page(data, drawn, folder / "compare.html", env.world)
    return folder / "compare.html"


def main() -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-compare", description=__doc__.split(": ", 1)[1])
    parser.add_argument("run", type=Path, metavar="RUN_DIR", help="a run directory of morlnav-train")
    parser.add_argument("folder", type=folder, metavar="FOLDER", help="receives the roll-outs and the page")
    parser.add_argument("--pairs", type=int, default=30, help="to ask for (default: 30)")
    parser.add_argument("--scenes", type=int, default=10, help="to drive in (default: 10)")
    parser.add_argument(
        "--steps", type=int, default=2, help="of every pairwise interpolation of preferences (default: 2)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of scenes and pairs")
    parser.add_argument("--trust", action="store_true", help="build classes from outside morlnav that the run names")
    args = parser.parse_args()
    with one_sentence_errors(own_classes=True):
        page = prepare(Run(args.run, args.trust), args.folder, args.pairs, args.scenes, args.steps, args.seed)
        print(f"Open {page} in a browser, and keep what it saves as {args.folder / COMPARISONS_FILE}")


if __name__ == "__main__":
    main()
