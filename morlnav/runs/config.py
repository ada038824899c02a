"""The config of a run on disk."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

CONFIG_FILE = "config.yaml"


def load_config(directory: str | Path, of_this_version: bool = False) -> dict[str, Any]:
    """What a run was made with; its text is taken as it is, and nothing in it is resolved.

    Args:
        directory: of the run.
        of_this_version: refuse a run of an older version, whose config has another structure.

    Raises:
        FileNotFoundError: if the directory holds no run.
        ValueError: if its config is damaged, or of an older version, which is named.

    Examples:
        >>> load_config("results/default")["seed"]
        0
    """
    path = Path(directory) / CONFIG_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{directory} is not a run directory: it holds no {CONFIG_FILE}.")
    config = read_yaml(path)
    if not isinstance(config, dict):
        raise ValueError(f"{path} is damaged: it maps no keys to values.")
    if of_this_version and "_target_" not in config:
        raise ValueError(f"{directory} was made by morlnav 0.1; this version reads runs since 0.2, so train it again.")
    return config


def read_yaml(path: Path) -> Any:
    """A file of a run as plain values; OmegaConf would resolve what strangers wrote there.

    Raises:
        ValueError: if it is no YAML.
    """
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(f"{path} is damaged: it is no YAML.") from error


def flat_settings(config: Mapping[str, Any], run: Path) -> dict[str, object]:
    """The config values of a run by their dotted names; where and how it went on is no setting, nor is its place."""
    flat = pd.json_normalize(dict(config)).to_dict("records")[0]
    for key in ("resume", "trust"):
        flat.pop(key, None)
    own = f"{run}{os.sep}"
    return {
        key: str(value).removeprefix(own) if isinstance(value, str | list | dict) else value
        for key, value in flat.items()
    }
