"""What a config may name without being trusted: parts that do nothing but their work."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

ROOMS = ("data", "evaluation", "modules", "navigation", "objectives", "record", "trainers", "transforms")
FUNCTIONS = ("morlnav.trainers.linear_decay", "morlnav.modules.load_module", "morlnav.envs.MOGymnasium")
LIBRARY = (
    "torchrl.collectors.Collector",
    "torchrl.data.LazyTensorStorage",
    "torchrl.data.PrioritizedSampler",
    "torchrl.data.RandomSampler",
    "torchrl.envs.RewardSum",
    "torchrl.envs.StepCounter",
    "torchrl.modules.AdditiveGaussianModule",
    "torchrl.objectives.SoftUpdate",
    "torchrl.record.CSVLogger",
    "torchrl.record.TensorboardLogger",
)


def foreign_targets(config: Any) -> list[str]:
    """The targets of a config that lie outside this package, but for known ones; nothing of them is imported.

    >>> loss = {"_target_": "morlnav.objectives.MORLTD3Loss"}
    >>> foreign_targets({"env": {"_target_": "shutil.copyfile"}, "loss": loss})
    ['shutil.copyfile']
    """
    return [target for target in dict.fromkeys(targets(config)) if not is_known(target)]


def targets(node: Any) -> Iterator[str]:
    """All that a config names as ``_target_``."""
    if isinstance(node, dict):
        if "_target_" in node:
            yield str(node["_target_"])
        for child in node.values():
            yield from targets(child)
    elif isinstance(node, list):
        for child in node:
            yield from targets(child)


def is_known(path: str) -> bool:
    """Whether a target is a part of ours or of a library that serves as one; the path alone does not tell."""
    if path in LIBRARY or path in FUNCTIONS:
        return True
    module, _, name = path.rpartition(".")
    if module == "torch.optim":
        return name.isidentifier()
    if not path.startswith(tuple(f"morlnav.{room}." for room in ROOMS)):
        return False
    try:
        target = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError):
        return False
    return isinstance(target, type) and target.__module__.startswith(tuple(f"morlnav.{room}" for room in ROOMS))
