"""``morlnav-audit RUN_DIR``: does a learned demonstration reward prefer the demonstration?"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig

from morlnav.cli import one_sentence_errors, quiet
from morlnav.evaluation import Audit, audit_reward, evaluation_scenes, write_audit
from morlnav.modules import NavigationFeatures, load_reward, read_facts, write_facts
from morlnav.trainers.builders import build
from morlnav.trainers.styles import (
    CLONE_FILE,
    demonstrated_objectives,
    make_demonstrator,
    style_config,
    style_directory,
    style_of,
)


def find_reward(path: Path) -> Path:
    """The saved reward model at ``path``: the model itself, in a folder of its own, or in a run directory.

    Raises:
        FileNotFoundError: if there is none.

    Examples:
        >>> import tempfile
        >>> run = Path(tempfile.mkdtemp())
        >>> (run / "reward.pt").touch()
        >>> find_reward(run).name
        'reward.pt'
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
    *,
    cfg: DictConfig | None = None,
    directory: Path | None = None,
    record: bool = True,
    **settings: Any,
) -> Audit:
    """Audit a saved reward, and write the verdict, tables and figures to ``output``.

    Args:
        path: of the model, of its folder, or of a run directory.
        output: where results go; ``audit`` beside the model by default.
        num_scenes: held-out scenes.
        scene_seed: of the scenes.
        cfg: of the run that learned the reward, as ``style_config`` shows it to the objective: judge in its world and
            scenes, against its demonstrator, with its scale and offset. Without it, everything is as in the paper.
        directory: of that run, which keeps a clone where no policy demonstrated; where the reward lies by default.
        record: also write the verdict into the reward's facts.
        settings: arguments of :func:`~morlnav.evaluation.audit_reward`, such as ``offset=1.0``; they win over ``cfg``.

    Returns:
        The audit.

    Raises:
        FileNotFoundError: if there is no reward.
        ValueError: if its files are damaged, or there is nobody to compare it with.
    """
    file = find_reward(path)
    reward = load_reward(file)
    sees = [module.observe_human for module in reward.modules() if isinstance(module, NavigationFeatures)]
    sampler, parts = None, {}
    if cfg is not None:
        sampler, name = build(cfg.env.scenes), style_of(cfg)
        parts = {"oracle": make_demonstrator(cfg, directory or file.parent), "world": build(cfg.world, device="cpu")}
        if parts["oracle"] is None:
            raise ValueError(f"{directory or file.parent} holds no {CLONE_FILE} that could drive as recorded.")
        demo, snippet = cfg.objectives[name], cfg.ranking.snippet or 25
        own = {"scale": demo.scale, "offset": demo.offset, "snippet": snippet, "max_steps": cfg.env.max_steps}
        settings = own | settings
    scenes = evaluation_scenes(num_scenes, seed=scene_seed, sampler=sampler)
    audit = audit_reward(reward, scenes=scenes, observe_human=all(sees), **parts, **settings)
    output = output or file.parent / "audit"
    settings = {"num_scenes": num_scenes, "scene_seed": scene_seed, **settings}
    write_audit(audit, output, settings)
    if record:
        write_facts(file, {**read_facts(file)["facts"], "audit": {"settings": settings, **audit.summary()}})
    return audit


def _choose(name: str | None, names: list[str]) -> str:
    if not names or (name is not None and name not in names):
        raise ValueError(f"The run learned no reward of {name or 'demonstrations'}; it learned {names or 'none'}.")
    return name or names[0]


def main() -> None:
    """Entry point; the exit status is 0 if the reward passed."""
    from morlnav.policy import CONFIG_FILE, check_targets, load_config  # whose training audits, too

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
    parser.add_argument("--output", type=Path, help="where results go (default: audit beside the model)")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads(), help="threads of PyTorch")
    parser.add_argument("--trust", action="store_true", help="build classes from outside morlnav that the run names")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    given = {name: getattr(args, name) for name in ("plans", "bare", "scale", "offset", "seed")}
    settings = {name: value for name, value in given.items() if value is not None}
    with one_sentence_errors():
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
