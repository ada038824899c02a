"""Where a run's rewards come from: one that lies there is used by the config that it was learned by alone."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from morlnav.modules import read_facts
from morlnav.trainers.styles import demonstrated_objectives, style_config, style_directory, style_of

WORLD = ("world", "env.scenes", "env.max_steps", "env.observe_human")
STAGES = (*WORLD, "demonstrations", "networks.features", "clone", "ranking")
"""What a reward model depends on."""


def parts_of(cfg: DictConfig, *groups: str) -> dict[str, Any]:
    """The seed, and parts of a config as plain values."""
    parts = {group: OmegaConf.select(cfg, group) for group in groups}
    content = {
        group: OmegaConf.to_container(part, resolve=True) if OmegaConf.is_config(part) else part
        for group, part in parts.items()
    }
    return content | {"seed": cfg.seed}


def digest(content: dict[str, Any]) -> str:
    """A short name for a content, the same for the same."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]


def origin(cfg: DictConfig) -> str:
    """What a run's reward comes from: the place of a saved one, or all that it is learned by.

    Neither threads nor versions count: a run that goes on elsewhere keeps its reward.
    """
    place = cfg.objectives[style_of(cfg)].reward.path
    return digest(parts_of(cfg, *STAGES) if place is None else {"path": place})


def use_kept_rewards(cfg: DictConfig, directory: Path) -> None:
    """Put the places of the rewards that a run keeps into ``cfg``; writes nothing.

    Raises:
        FileNotFoundError: if one of them is missing.
        ValueError: if one of them belongs to another config.
    """
    for path, view in saved_rewards(cfg, directory).items():
        _check(view, path)
        cfg.objectives[style_of(view)].reward.path = str(path)


def use_own_offsets(cfg: DictConfig) -> None:
    """Give every demonstrated objective the offset of its own ranking."""
    for name in demonstrated_objectives(cfg):
        view = style_config(cfg, name)
        if "offset" in view.objectives[name]:
            cfg.objectives[name].offset = view.objectives[name].offset


def refuse_other_rewards(cfg: DictConfig, directory: Path) -> None:
    """Refuse a directory with rewards of another config, before anything is written there.

    Raises:
        FileNotFoundError: if only a half of one is there.
        ValueError: naming the reward.
    """
    for path, view in saved_rewards(cfg, directory).items():
        if path.exists():
            _check(view, path)


def saved_rewards(cfg: DictConfig, directory: Path) -> dict[Path, DictConfig]:
    """Where the run's rewards lie, with the configs as they see them; classes of the user's own are not among them."""
    views = {name: style_config(cfg, name) for name in demonstrated_objectives(cfg)}
    return {
        style_directory(directory, name) / "reward.pt": view
        for name, view in views.items()
        if "path" in view.objectives[name].reward
    }


def _check(cfg: DictConfig, path: Path) -> None:
    named = cfg.objectives[style_of(cfg)].reward.path == str(path)
    if read_facts(path)["facts"].get("origin") != origin(cfg) and not named:
        raise ValueError(
            f"{path} belongs to another config than that of this run; train in another directory, or name that reward "
            f"as objectives.{style_of(cfg)}.reward.path."
        )
