"""The config of a run on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
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
