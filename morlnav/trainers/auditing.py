"""The audit of a saved reward, in the world and against the demonstrator that it was learned from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from morlnav.modules import load_reward, read_facts, write_facts
from morlnav.navigation.audit import Audit, audit_reward, write_audit
from morlnav.navigation.evaluation import evaluation_scenes
from morlnav.navigation.modules import NavigationFeatures
from morlnav.trainers.builders import build
from morlnav.trainers.styles import CLONE_FILE, make_demonstrator, style_of


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
        settings: arguments of :func:`~morlnav.navigation.audit.audit_reward`, such as ``offset=1.0``; they win over ``cfg``.

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
