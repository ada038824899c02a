"""Modules on disk: weights without pickled code, and what they are as readable JSON."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Collection, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import torch
from torch import nn

from morlnav.files import BLOCK, digest, require_room, sha256, write_bytes, write_text
from morlnav.modules.checks import check_weights

OURS = ("morlnav.modules.", "morlnav.navigation.modules.")
"""Where the classes of a saved module may come from; building them does nothing else."""

OF_THE_REST = "sha256_of_the_rest"
"""What a description calls the hash of all else that it says."""


def save_module(model: nn.Module, path: str | Path, facts: Mapping[str, Any] | None = None) -> None:
    """Write a module as two files: its weights into ``path``, and what it is into the same name with ``.json``.

    The description holds the SHA-256 of the weights and of itself, so that a changed file is noticed when it is loaded.

    Args:
        model: made of classes with a method ``config()``, which gives their constructor's arguments; arguments may be
            such modules themselves, or lists of them.
        path: of the weights, such as ``reward.pt``; its directory is made.
        facts: anything worth knowing that JSON can hold, such as the result of an audit.

    Raises:
        OSError: if the disk has too little room.
        ValueError: for a module that cannot be described, or weights that are not finite.

    Examples:
        >>> import tempfile
        >>> from morlnav.modules import Actor
        >>> path = Path(tempfile.mkdtemp()) / "policy.pt"
        >>> save_module(Actor(2, [-1.0], [1.0], features=3, depth=1), path, {"objectives": ["fast", "safe"]})
        >>> load_module(path).depth, read_facts(path)
        (1, {'objectives': ['fast', 'safe']})
    """
    check_weights(model, str(path))
    path, description = Path(path), {"model": _describe(model), "facts": dict(facts or {})}
    json.dumps(description)  # which may fail, so before anything is written
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(model.state_dict(), content := io.BytesIO())
    weights = content.getvalue()
    require_room(path.parent, len(weights) + 16 * BLOCK)
    _write(path, description | {"sha256": hashlib.sha256(weights).hexdigest()})
    write_bytes(path, weights)  # last, and at once: where the weights are, they are whole, and so is the rest


def write_facts(path: str | Path, facts: Mapping[str, Any]) -> None:
    """Replace the facts of a saved module; its weights stay as they are.

    Raises:
        FileNotFoundError: if one of the two files is missing.
        ValueError: if one is damaged.
    """
    _write(Path(path), _read(path) | {"facts": dict(facts)})


def read_facts(path: str | Path) -> dict[str, Any]:
    """What was written beside a saved module.

    Raises:
        FileNotFoundError: if one of the two files is missing.
        ValueError: if one is damaged.
    """
    return _read(path)["facts"]


def load_module(
    path: str | Path, device: torch.device | str = "cpu", trust: bool | Collection[str] = False
) -> nn.Module:
    """The module of :func:`save_module`, frozen: in evaluation mode, without gradients for its weights.

    Only modules of this package are built and nothing is unpickled, so files of strangers do no harm.

    Args:
        path: of the weights.
        device: where to put them.
        trust: also build classes from outside this package: all, which is only for files of your own, for it runs their
            code; or those of these names.

    Raises:
        FileNotFoundError: if one of the two files is missing.
        ValueError: if a file is damaged, names a foreign class, or the two do not belong together.
    """
    description = _read(path)
    with torch.random.fork_rng(devices=[]):  # what is drawn afterwards does not depend on what was loaded
        model = _build(description["model"], Path(path).with_suffix(".json"), trust)
    model = load_weights(model, path, device).requires_grad_(False)
    check_weights(model, str(path))
    return model


def load_weights(model: nn.Module, path: str | Path, device: torch.device | str = "cpu") -> nn.Module:
    """The module with the weights that a file holds, in evaluation mode; nothing is unpickled.

    Args:
        model: takes the weights.
        path: of a ``state_dict``.
        device: where to put the module.

    Raises:
        ValueError: if the file is damaged, or holds the weights of another module.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "linear.pt"
        >>> torch.save(nn.Linear(2, 1).state_dict(), path)
        >>> load_weights(nn.Linear(2, 1), path)
        Linear(in_features=2, out_features=1, bias=True)
    """
    try:
        model.load_state_dict(torch.load(path, weights_only=True, map_location=device))
    except Exception as error:  # a damaged file may raise anything in torch's reader
        raise ValueError(f"{path} does not hold the weights of this {type(model).__name__}.") from error
    return model.to(device).eval()


def _write(path: Path, content: Mapping[str, Any]) -> None:
    content = json.loads(json.dumps(content))  # first, for it may fail; as it will be read
    write_text(path.with_suffix(".json"), json.dumps(content | {OF_THE_REST: digest(content)}, indent=2) + "\n")


def _read(path: str | Path) -> dict[str, Any]:
    description = Path(path).with_suffix(".json")
    for file in (Path(path), description):
        if not file.is_file():
            raise FileNotFoundError(f"There is no {file}; a saved module is two files, {path} and {description.name}.")
    try:
        content = json.loads(description.read_text(encoding="utf-8"))
        read = {"model": dict(content["model"]), "facts": dict(content["facts"]), "sha256": content.get("sha256")}
        whole = set(content) <= set(read) or content.get(OF_THE_REST) == digest(read)  # the first files had no hash
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"{description} does not describe a saved module; save it again.") from error
    if "_target_" not in read["model"]:
        raise ValueError(f"{description} was made by morlnav 0.1, which this version does not read; train it again.")
    if not whole:
        raise ValueError(f"{description} is damaged: it does not hold what was saved.")
    if read["sha256"] not in (None, sha256(Path(path))):
        raise ValueError(f"{path} is damaged: it does not hold the weights that were saved.")
    return read


def _describe(value: Any) -> Any:
    if isinstance(value, nn.Module):
        if not hasattr(value, "config"):
            raise ValueError(f"A {type(value).__name__} cannot be saved: it has no method config().")
        cls = type(value)
        return {"_target_": f"{cls.__module__}.{cls.__qualname__}", **_describe(value.config())}
    if isinstance(value, Mapping):
        return {name: _describe(child) for name, child in value.items()}
    return [_describe(child) for child in value] if isinstance(value, list | tuple) else value


def _build(value: Any, file: Path, trust: bool | Collection[str]) -> Any:
    if isinstance(value, list):
        return [_build(child, file, trust) for child in value]
    if not isinstance(value, dict):
        return value
    arguments = {name: _build(child, file, trust) for name, child in value.items() if name != "_target_"}
    if "_target_" not in value:
        return arguments
    cls = _find(str(value["_target_"]), file, trust)
    try:
        return cls(**arguments)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{file} describes a {cls.__name__} that cannot be built: {error}") from error


def _find(target: str, file: Path, trust: bool | Collection[str]) -> type[nn.Module]:
    ours = target.startswith(OURS)
    if not ours and trust is not True and target not in (trust or ()):
        raise ValueError(
            f"{file} names the foreign class {target}; if it is your own, load it with trust=True (--trust on the "
            f"command line)."
        )
    module, _, name = target.rpartition(".")
    try:
        cls = getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"{file} names {target}, which is not there: {error}") from error
    if not (isinstance(cls, type) and issubclass(cls, nn.Module)) or (ours and cls.__module__ != module):
        raise ValueError(f"{file} names {target}, which is no module of this package.")
    return cls
