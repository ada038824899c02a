"""``morlnav-audit RUN_DIR``: does a learned demonstration reward prefer the demonstration?"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from morlnav.cli import one_sentence_errors, quiet, set_threads
from morlnav.deployment.policy import CONFIG_FILE, check_targets, load_config
from morlnav.trainers.auditing import audit_run, find_reward
from morlnav.trainers.styles import demonstrated_objectives, style_config, style_directory


def _choose(name: str | None, names: list[str]) -> str:
    if not names or (name is not None and name not in names):
        raise ValueError(f"The run learned no reward of {name or 'demonstrations'}; it learned {names or 'none'}.")
    return name or names[0]


def main() -> None:
    """Entry point; the exit status is 0 if the reward passed."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-audit", description=__doc__.split(": ", 1)[1])
    parser.add_argument("path", type=Path, metavar="RUN_DIR", help="a run directory, or where a reward.pt lies")
    parser.add_argument("--objective", help="of the run's demonstrated objectives (default: the first)")
    parser.add_argument("--scenes", type=int, default=100, help="held-out scenes (default: 100)")
    parser.add_argument("--scene-seed", type=int, default=0, help="seed of the scenes")
    parser.add_argument("--plans", type=int, default=3, help="scenes to plan the best path in (default: 3; 0: none)")
    parser.add_argument("--bare", action="store_true", help="take the boxes out of every second planned scene")
    parser.add_argument("--scale", type=float, help="the factor c_d (default: the run's, else 10)")
    parser.add_argument(
        "--offset", type=float, help="b_d, added to the reward (default: the run's, else -1; printed: 1)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of noise and bootstrap")
    parser.add_argument(
        "--output",
        type=Path,
        help="where results go (default: audit beside the model, which then holds the verdict, too)",
    )
    parser.add_argument("--threads", type=int, default=1, help="threads of PyTorch (default: 1)")
    parser.add_argument("--trust", action="store_true", help="build classes from outside morlnav that the run names")
    args = parser.parse_args()
    given = {name: getattr(args, name) for name in ("plans", "bare", "scale", "offset", "seed")}
    settings = {name: value for name, value in given.items() if value is not None}
    settings["record"] = args.output is None  # what is written elsewhere leaves the run as it is
    with one_sentence_errors():
        set_threads(args.threads)
        cfg, place = None, args.path
        if (args.path / CONFIG_FILE).is_file():
            run = load_config(args.path)
            if not args.trust:
                check_targets(run)
            name = _choose(args.objective, demonstrated_objectives(run))
            cfg, place = style_config(run, name), style_directory(args.path, name)
        output = args.output or find_reward(place).parent / "audit"
        audit = audit_run(place, output, args.scenes, args.scene_seed, cfg=cfg, directory=args.path, **settings)
        print(f"{(output / 'audit.md').read_text()}\nTables and figures are in {output}")
        sys.exit(0 if audit.passed else 1)


if __name__ == "__main__":
    main()
