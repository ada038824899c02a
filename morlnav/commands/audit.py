"""``morlnav-audit RUN_DIR``: does a learned demonstration reward prefer the demonstration?"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from morlnav.annotations import with_article
from morlnav.cli import folder, one_sentence_errors, quiet, set_threads, writable
from morlnav.modules import RewardModel, load_module, read_facts, write_facts
from morlnav.navigation.audit import RewardAudit
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import SceneSampler, TensorWorld
from morlnav.runs import CONFIG_FILE, Run
from morlnav.trainers import DREX
from morlnav.trainers.drex import place


def audit(
    path: Path, output: Path | None = None, objective: str | None = None, trust: bool = False, **settings: Any
) -> tuple[bool, Path]:
    """Audit a saved reward, and write the verdict, tables and figures.

    Args:
        path: of a run directory, whose world, demonstrator, scale and offset count; or of a model, which is judged
            against the paper's demonstrator in the paper's world.
        output: where results go; ``audit`` beside the model by default, which then holds the verdict, too.
        objective: of the run's demonstrated ones; the first by default.
        trust: build classes from outside this package that the run names.
        settings: of :class:`~morlnav.navigation.audit.RewardAudit`, ``scale`` and ``offset``; ``None`` is the run's.

    Returns:
        Whether the reward passed, and where the report is.

    Raises:
        FileNotFoundError: if there is no reward.
        ValueError: if its files are damaged, or the run learned no such reward.
    """
    given = {name: value for name, value in settings.items() if value is not None}
    paid = {name: given.pop(name) for name in ("scale", "offset") if name in given}
    if (path / CONFIG_FILE).is_file():
        run = Run(path, trust)
        pipeline = _pipeline(run, given)
        name = _choose(objective, pipeline.names)
        file, judge, demonstrator = place(path, name) / "reward.pt", pipeline.audit, run.learned[name].demonstrator
        paid = {"scale": pipeline.scale, "offset": pipeline.offset, "snippet": pipeline.ranking.snippet or 25} | paid
    else:
        if objective is not None:
            raise ValueError(f"--objective belongs to a run, and {path} is none.")
        file, demonstrator = path if path.is_file() else path / "reward.pt", CircumnavigationOracle()
        if not file.is_file():
            raise FileNotFoundError(f"There is no reward model in {path}; expected reward.pt there.")
        judge = RewardAudit(world=TensorWorld(), scenes=SceneSampler(), **given)
    report, reward = writable(output or file.parent / "audit"), load_module(file, trust=trust)
    if not any(isinstance(part, RewardModel) for part in reward.modules()):
        raise ValueError(f"{file} holds {with_article(type(reward).__name__)}, and no reward that could be audited.")
    judge.judge(reward, demonstrator, report, **paid)
    verdict = judge.read(report)
    if output is None:  # what is written elsewhere leaves the run as it is
        write_facts(file, {**read_facts(file), "audit": verdict})
    return verdict["passed"], report


def _pipeline(run: Run, changes: dict[str, Any]) -> DREX:
    node = run.config.get("rewards")
    if not node or not node.get("audit"):
        raise ValueError(f"{run.directory} learned no reward that could be audited.")
    node["audit"] |= changes
    return run.training.pipeline()


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
    parser.add_argument("--scenes", type=int, help="held-out scenes (default: the run's, else 100)")
    parser.add_argument("--scene-seed", type=int, help="seed of the scenes")
    parser.add_argument("--plans", type=int, help="scenes to plan the best path in; 0: none")
    parser.add_argument(
        "--bare", action="store_true", default=None, help="take the boxes out of every second planned scene"
    )
    parser.add_argument("--scale", type=float, help="the factor c_d (default: the run's, else 10)")
    parser.add_argument(
        "--offset", type=float, help="b_d, added to the reward (default: the run's, else -1; printed: 1)"
    )
    parser.add_argument("--seed", type=int, help="seed of noise and bootstrap")
    parser.add_argument(
        "--output",
        type=folder,
        help="where results go (default: audit beside the model, which then holds the verdict, too)",
    )
    parser.add_argument("--threads", type=int, default=1, help="threads of PyTorch (default: 1)")
    parser.add_argument("--trust", action="store_true", help="build classes from outside morlnav that the run names")
    args = parser.parse_args()
    if args.bare and args.plans == 0:
        parser.error("--bare is about planned scenes, and --plans 0 plans in none")
    settings = {name: getattr(args, name) for name in ("plans", "bare", "scale", "offset", "seed", "scene_seed")}
    with one_sentence_errors(own_classes=True):
        set_threads(args.threads)
        settings["num_scenes"] = args.scenes
        passed, report = audit(args.path, args.output, args.objective, args.trust, **settings)
        print(f"{(report / 'audit.md').read_text()}\nTables and figures are in {report}")
        sys.exit(0 if passed else 1)


if __name__ == "__main__":
    main()
