"""Demonstrations on disk: folders of memory-mapped tensors with a header, saved and loaded without pickled code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tensordict import TensorDict
from torch import Tensor

from morlnav.files import sha256, write_tensors

SCHEMA = "morlnav.demonstrations"
VERSION = 1
HEADER = "demonstrations.json"
ENTRIES = {"observation", "action", "executed_action", "pose", "scene", "episode", "step", "next"}


def save_demonstrations(data: TensorDict, path: str | Path, settings: Mapping[str, Any] | None = None) -> None:
    """Write demonstrations into a new folder: one memory-mapped file per entry, and ``demonstrations.json``.

    Args:
        data: as :func:`record_demonstrations` returns them.
        path: of the folder; it may exist if it is empty.
        settings: anything worth remembering about the recording, in JSON's types.

    Raises:
        FileExistsError: if the folder holds anything.
        OSError: if the disk has too little room.
        ValueError: if the data are no demonstrations or hold anything but tensors.
        TypeError: if the settings are not JSON.
    """
    path = Path(path)
    problem = _problem(data)
    if problem:
        raise ValueError(f"These are no demonstrations that can be saved: {problem}.")
    if path.exists() and any(path.iterdir()):
        raise FileExistsError(f"{path} is not empty; save demonstrations into a new folder.")
    settings = json.loads(json.dumps(dict(settings or {})))
    write_tensors(data, path / "data")
    header = {
        "schema": SCHEMA,
        "version": VERSION,
        "episodes": int(data["episode"].unique().numel()),
        "transitions": len(data),
        "settings": settings,
        "files": _files(path / "data"),
        "sha256": _hashes(path / "data"),
    }
    (path / HEADER).write_text(json.dumps(header, indent=2) + "\n", encoding="utf-8")


def load_demonstrations(path: str | Path) -> TensorDict:
    """Read a folder that :func:`save_demonstrations` wrote; no code is unpickled.

    Args:
        path: of the folder.

    Returns:
        The transitions ``[N]``, in main memory.

    Raises:
        FileNotFoundError: if the folder holds no demonstrations.
        ValueError: if they are of another schema or version, or damaged.
    """
    path = Path(path)
    header = _header(path)
    listed = header.get("files")
    if listed != _files(path / "data") or not all(name.endswith((".memmap", "meta.json")) for name in listed):
        raise ValueError(f"The demonstrations in {path} are damaged: their files are not those that were saved.")
    if header.get("sha256") not in (None, _hashes(path / "data")):  # the first releases kept sizes alone
        raise ValueError(f"The demonstrations in {path} are damaged: their files hold other content than was saved.")
    try:
        data = TensorDict.load_memmap(path / "data", allow_pickle=False).clone()
        problem = _problem(data)
    except Exception as error:
        raise ValueError(f"The demonstrations in {path} are damaged: {error}") from error
    if problem or len(data) != header.get("transitions"):
        raise ValueError(f"The demonstrations in {path} are damaged: {problem or 'transitions are missing'}.")
    return data


def demonstration_settings(path: str | Path) -> dict[str, Any]:
    """The settings that demonstrations were saved with; errors as for :func:`load_demonstrations`."""
    return _header(Path(path)).get("settings", {})


def demonstrations_digest(path: str | Path) -> str:
    """A hash of all that a folder of demonstrations holds, which tells whether they are still the same.

    Args:
        path: of the folder.

    Raises:
        FileNotFoundError: if the folder holds no demonstrations.
        ValueError: if its header is damaged.
    """
    path = Path(path)
    digest = hashlib.sha256()
    for name in (HEADER, *(f"data/{name}" for name in _header(path).get("files", {}))):
        if not (path / name).is_file():
            raise FileNotFoundError(f"The demonstrations in {path} are damaged: {name} is missing.")
        digest.update((path / name).read_bytes())
    return digest.hexdigest()[:16]


def _header(path: Path) -> dict[str, Any]:
    file = path / HEADER
    if not file.is_file():
        raise FileNotFoundError(f"{path} holds no demonstrations: there is no {HEADER}.")
    try:
        header = json.loads(file.read_text(encoding="utf-8"))
        schema, version = header["schema"], header["version"]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{file} is damaged: it does not name a schema and a version.") from error
    if (schema, version) != (SCHEMA, VERSION):
        raise ValueError(
            f"{path} holds {schema!r} version {version!r}; this release reads {SCHEMA!r} version {VERSION}."
        )
    return header


def _files(folder: Path) -> dict[str, int]:
    """All files below a folder and their sizes in bytes."""
    return {
        file.relative_to(folder).as_posix(): file.stat().st_size for file in sorted(folder.rglob("*")) if file.is_file()
    }


def _hashes(folder: Path) -> dict[str, str]:
    return {name: sha256(folder / name) for name in _files(folder)}


def _problem(data: Any) -> str | None:
    if not isinstance(data, TensorDict) or data.batch_dims != 1:
        return "they are not a TensorDict with one batch dimension"
    missing = sorted(ENTRIES - set(data.keys()))
    if missing:
        return f"they lack {', '.join(missing)}"
    leaves = data.items(True, True, is_leaf=lambda kind: kind is not TensorDict)
    foreign = [key for key, value in leaves if not isinstance(value, Tensor)]
    return f"{foreign} are no tensors" if foreign else None
