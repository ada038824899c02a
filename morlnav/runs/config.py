"""The config of a run on disk."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import DictConfig, OmegaConf
from yaml import YAMLError

CONFIG_FILE = "config.yaml"


def load_config(directory: str | Path) -> dict[str, Any]:
    """What a run was made with; its text is taken as it is, and nothing in it is resolved.

    Raises:
        FileNotFoundError: if the directory holds no run.
        ValueError: if its config is damaged.

    Examples:
        >>> load_config("results/default")["seed"]
        0
    """
    path = Path(directory) / CONFIG_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{directory} is not a run directory: it holds no {CONFIG_FILE}.")
    try:
        config = OmegaConf.load(path)
    except (YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is damaged: it is no YAML.") from error
    if not OmegaConf.is_dict(config):
        raise ValueError(f"{path} is damaged: it maps no keys to values.")
    return OmegaConf.to_container(config, resolve=False)


def flat_settings(cfg: DictConfig | dict[str, Any], run: Path, resolve: bool = True) -> dict[str, object]:
    """The config values of a run by their dotted names; where and how it went on is no setting, nor is its place."""
    settings = OmegaConf.to_container(cfg, resolve=resolve) if OmegaConf.is_config(cfg) else cfg
    flat = pd.json_normalize(settings).to_dict("records")[0]
    for key in ("resume", "trust"):
        flat.pop(key, None)
    own = f"{run}{os.sep}"
    return {
        key: str(value).removeprefix(own) if isinstance(value, str | list | dict) else value
        for key, value in flat.items()
    }
