"""What a config may name without being trusted: parts that do nothing but their work."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

ROOMS = ("data", "evaluation", "modules", "navigation", "objectives", "trainers", "transforms")
OURS = tuple(f"morlnav.{room}." for room in ROOMS)
FUNCTIONS = ("morlnav.trainers.linear_decay",)
LIBRARY = (
    "torchrl.data.LazyTensorStorage",
    "torchrl.data.PrioritizedSampler",
    "torchrl.data.RandomSampler",
    "torchrl.envs.InitTracker",
    "torchrl.envs.RewardSum",
    "torchrl.envs.StepCounter",
    "torchrl.modules.AdditiveGaussianModule",
    "torchrl.objectives.SoftUpdate",
)
GYMNASIUM = "morlnav.envs.MOGymnasium"
RAY = "morlnav.trainers.ray"
"""Its collector may join a cluster of strangers."""

IN_THEIR_PLACE = {
    "collector": ("torchrl.collectors.Collector",),
    "logger": ("morlnav.record.TensorboardCSVLogger", "torchrl.record.CSVLogger", "torchrl.record.TensorboardLogger"),
}
"""What starts workers or writes files; a training alone builds it, and there alone."""


def foreign_targets(config: dict[str, Any]) -> list[str]:
    """The targets of a config that lie outside this package, but for known ones; nothing of them is imported.

    >>> foreign_targets({"env": {"_target_": "shutil.copyfile"}, "stepper": {"_target_": "torch.optim.Adam"}})
    ['shutil.copyfile']
    >>> logger = {"_target_": "torchrl.record.CSVLogger"}
    >>> foreign_targets({"logger": logger}), foreign_targets({"env": {"world": logger}})
    ([], ['torchrl.record.CSVLogger'])
    """
    rest = dict(config)
    for place, known in IN_THEIR_PLACE.items():
        if isinstance(rest.get(place), dict) and rest[place].get("_target_") in known:
            rest[place] = {name: child for name, child in rest[place].items() if name != "_target_"}
    foreign = [target for target in targets(rest) if not is_known(target)]
    return list(dict.fromkeys([*foreign, *_imported_tasks(rest)]))


def refusal(target: str, how: str) -> str:
    """Why a run that names a foreign target is refused, and how to have it nevertheless.

    >>> refusal("my_parts.Mine", "trust it")
    'This run uses the foreign my_parts.Mine; trust it.'
    >>> refusal("morlnav.objectives.Old", "trust it")
    'This run uses the foreign morlnav.objectives.Old, which this version of morlnav does not have; train it again.'
    """
    if target.startswith(OURS) and _ours(target) is None:
        return f"This run uses the foreign {target}, which this version of morlnav does not have; train it again."
    return f"This run uses the foreign {target}; {how}."


def targets(node: Any) -> Iterator[str]:
    """All that a config names as ``_target_``."""
    return (str(part["_target_"]) for part in _nodes(node))


def is_known(path: str) -> bool:
    """Whether a target is a part of ours or of a library that serves as one; the path alone does not tell."""
    if path in LIBRARY or path in FUNCTIONS or path == GYMNASIUM:
        return True
    module, _, name = path.rpartition(".")
    if module == "torch.optim":
        return name.isidentifier()
    target = _ours(path) if path.startswith(OURS) else None
    home = f"{getattr(target, '__module__', '')}."
    return isinstance(target, type) and home.startswith(OURS) and home != f"{RAY}."


def _ours(path: str) -> Any:
    """What stands at a path in our own modules, or ``None``."""
    module, _, name = path.rpartition(".")
    try:
        return getattr(importlib.import_module(module), name, None)
    except ImportError:
        return None


def _imported_tasks(node: Any) -> list[str]:
    """Tasks such as ``package:Task-v0``, for which Gymnasium imports the package."""
    tasks = [str(part.get("id")) for part in _nodes(node) if part["_target_"] == GYMNASIUM]
    return [task for task in tasks if ":" in task]


def _nodes(node: Any) -> Iterator[dict[str, Any]]:
    if isinstance(node, dict):
        if "_target_" in node:
            yield node
        for child in node.values():
            yield from _nodes(child)
    elif isinstance(node, list):
        for child in node:
            yield from _nodes(child)
