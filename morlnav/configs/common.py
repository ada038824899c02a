"""What all configs share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from hydra.core.config_store import ConfigStore
from torchrl.trainers.algorithms.configs.common import ConfigBase

T = TypeVar("T", bound=type[ConfigBase])

CONFIGS: dict[tuple[str, str], type[ConfigBase]] = {}
"""All configs of this package by group and name."""


@dataclass
class PartConfig(ConfigBase):
    """Base of the configs: arguments reach a constructor as plain numbers, lists and dicts, not as OmegaConf's.

    With ``_partial_`` a part is not built but becomes a callable that still waits for arguments.
    """

    _partial_: bool = False
    _convert_: str = "all"

    def __post_init__(self) -> None:
        """Nothing: the constructors check their arguments."""


def store(group: str, name: str) -> Callable[[T], T]:
    """Register a config in Hydra's ``ConfigStore``, under a group of TorchRL's or one of our own.

    The name must differ from those of the group's YAML files, for Hydra would take it for their schema.

    Examples:
        >>> @store("vehicle", "truck")
        ... @dataclass
        ... class TruckConfig(PartConfig):
        ...     _target_: str = "my_package.Truck"
        >>> ConfigStore.instance().load("vehicle/truck.yaml").node._target_
        'my_package.Truck'
    """

    def register(config: T) -> T:
        ConfigStore.instance().store(group=group, name=name, node=config, provider="morlnav")
        CONFIGS[group, name] = config
        return config

    return register
