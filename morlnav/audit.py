"""``morlnav-audit RUN_DIR``: does a learned demonstration reward prefer the demonstration?"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import torch

from morlnav.cli import one_sentence_errors, quiet
from morlnav.evaluation import Audit, audit_reward, evaluation_scenes, write_audit
from morlnav.modules import NavigationFeatures, load_reward, read_facts, save_reward


def find_reward(path: Path) -> Path:
    """The saved reward model at ``path``: the model itself, in a folder of its own, or in a run directory.

    Raises:
        FileNotFoundError: if there is none.
    """
    for place in (path, path / "reward.pt", path / "reward" / "reward.pt"):
        if place.is_file():
            return place
    raise FileNotFoundError(f"There is no reward model in {path}; expected reward.pt there or in {path / 'reward'}.")


def audit_run(
    path: Path,
    output: Path | None = None,
    num_scenes: int = 100,
    scene_seed: int = 0,
    **settings: Any,
) -> Audit:
    """Audit a saved reward, write tables and figures to ``output``, and the verdict into the reward's facts.

    Args:
        path: of the model, of its folder, or of a run directory.
        output: where results go; ``audit`` beside the model by default.
        num_scenes: held-out scenes.
        scene_seed: of the scenes.
        settings: arguments of :func:`~morlnav.evaluation.audit_reward`, such as ``offset=1.0``.

    Returns:
        The audit.

    Raises:
        FileNotFoundError: if there is no reward.
        ValueError: if its files are damaged.
    """
    file = find_reward(path)
    reward = load_reward(file)
    sees = [module.observe_human for module in reward.modules() if isinstance(module, NavigationFeatures)]
    audit = audit_reward(
        reward, scenes=evaluation_scenes(num_scenes, seed=scene_seed), observe_human=all(sees), **settings
    )
    output = output or file.parent / "audit"
    write_audit(audit, output)
    verdict = {"settings": {"num_scenes": num_scenes, "scene_seed": scene_seed, **settings}, **audit.summary()}
    save_reward(reward, file, {**read_facts(file)["facts"], "audit": verdict})
    return audit


def main() -> None:
    """Entry point; the exit status is 0 if the reward passed."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-audit", description=__doc__.split(": ", 1)[1])
    parser.add_argument("path", type=Path, metavar="RUN_DIR", help="a run directory, or where a reward.pt lies")
    parser.add_argument("--scenes", type=int, default=100, help="held-out scenes (default: 100)")
    parser.add_argument("--scene-seed", type=int, default=0, help="seed of the scenes")
    parser.add_argument("--plans", type=int, default=3, help="scenes to plan the best path in (default: 3; 0: none)")
    parser.add_argument("--scale", type=float, default=10.0, help="the factor c_d (default: 10)")
    parser.add_argument("--offset", type=float, default=-1.0, help="b_d, added to the reward (default: -1; printed: 1)")
    parser.add_argument("--seed", type=int, default=0, help="seed of noise and bootstrap")
    parser.add_argument("--output", type=Path, help="where results go (default: audit beside the model)")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads(), help="threads of PyTorch")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    settings = {name: getattr(args, name) for name in ("plans", "scale", "offset", "seed")}
    with one_sentence_errors():
        output = args.output or find_reward(args.path).parent / "audit"
        audit = audit_run(args.path, output, args.scenes, args.scene_seed, **settings)
        print(f"{(output / 'audit.md').read_text()}\nTables and figures are in {output}")
        sys.exit(0 if audit.passed else 1)


if __name__ == "__main__":
    main()
