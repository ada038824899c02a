"""Demonstrations on disk: folders of memory-mapped tensors with a header, saved and loaded without pickled code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from morlnav.files import digest, sha256, write_tensors, write_text
from morlnav.navigation.world import World

SCHEMA = "morlnav.demonstrations"
VERSION = 1
HEADER = "demonstrations.json"
ENTRIES = {"observation", "action", "executed_action", "pose", "scene", "episode", "step", "next"}
OF_THE_REST = "sha256_of_the_rest"
"""What a header calls the hash of all else that it says."""
ENTRIES_TOLD = {"schema", "version", "episodes", "transitions", "settings", "files", "sha256"}
ABSENT = (1000.0, 1000.0, 0.1, 0.1, 0.0)
"""A box that is out of everyone's way, where a scene has fewer boxes than others."""


def save_demonstrations(
    data: TensorDict, path: str | Path, settings: Mapping[str, Any] | None = None, world: World | None = None
) -> None:
    """Write demonstrations into a new folder: one memory-mapped file per entry, and ``demonstrations.json``.

    Args:
        data: as :func:`record_demonstrations` returns them.
        path: of the folder; it may exist if it is empty.
        settings: anything worth remembering about the recording, in JSON's types.
        world: that it was recorded in, whose settings go with it; another one is refused when it is trained on.

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
    settings = json.loads(json.dumps({**(settings or {}), **({"world": world.settings} if world else {})}))
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
    write_text(path / HEADER, json.dumps(header | {OF_THE_REST: digest(header)}, indent=2) + "\n")


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


def check_world(path: str | Path, world: World) -> None:
    """Refuse a folder of demonstrations that were recorded with another robot, lidar or step time.

    Args:
        path: of the folder; one that does not tell its world is let pass.
        world: that it shall be used in.

    Raises:
        FileNotFoundError: if the folder holds no demonstrations.
        ValueError: naming what differs.
    """
    recorded, here = demonstration_settings(path).get("world", {}), world.settings
    differ = [name for name in recorded if name in here and recorded[name] != here[name]]
    if differ:
        told = " and ".join(f"{name}={_short(recorded[name])} (here {_short(here[name])})" for name in differ)
        keys = " ".join(f"env.world.{name}={recorded[name]}" for name in differ)
        raise ValueError(f"The demonstrations in {path} were recorded with {told}; set {keys}, or record anew.")


def check_drives(data: TensorDict, name: str, world: World) -> None:
    """Refuse demonstrations ``[N]`` that nobody can have driven in a world.

    Args:
        data: as :func:`record_demonstrations` returns them.
        name: of the demonstrations, for the message.
        world: that they are said to be driven in.

    Raises:
        ValueError: for another width of observations, too fast actions, or steps that take another time.
    """
    name, width, wanted = name[0].upper() + name[1:], data["observation"].shape[-1], 4 + world.lidar.sectors
    if width != wanted:
        raise ValueError(f"{name} hold observations of {width} numbers, the world has {wanted}.")
    speed, limit = data["action"][:, 0].max(), world.robot.action_high[0]
    if speed > 1.01 * limit:
        raise ValueError(f"{name} drive up to {speed:.2f} m/s, the world's robot {limit:.2g}.")
    driven = world.robot.move(data["pose"], data["executed_action"], world.step_time)
    apart = (driven - data["next", "pose"])[:, :2].norm(dim=-1)[~data["next", "done"].squeeze(-1)]
    if len(apart) and apart.median() > 0.005:
        raise ValueError(
            f"{name} do not get from pose to pose by their actions in steps of {world.step_time:g} s; set "
            f"env.world.step_time to that of the recording."
        )


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def demonstrations_digest(path: str | Path | Sequence[str | Path]) -> str:
    """A hash of all that folders of demonstrations hold, which tells whether they are still the same.

    Args:
        path: of the folder, or of several.

    Raises:
        FileNotFoundError: if a folder holds no demonstrations.
        ValueError: if its header is damaged.
    """
    digest = hashlib.sha256()
    for folder in map(Path, [path] if isinstance(path, str | Path) else path):
        for name in (HEADER, *(f"data/{name}" for name in _header(folder).get("files", {}))):
            if not (folder / name).is_file():
                raise FileNotFoundError(f"The demonstrations in {folder} are damaged: {name} is missing.")
            digest.update((folder / name).read_bytes())
    return digest.hexdigest()[:16]


def join_demonstrations(parts: Sequence[TensorDict]) -> TensorDict:
    """Demonstrations ``[N_i]`` of several recordings as one ``[N]``, episodes numbered on, with room for most boxes.

    Rewards stay if all parts have as many; others are computed anew where they are needed
    (:func:`~morlnav.navigation.demonstrations.rewarded_transitions`).

    Raises:
        ValueError: if their observations are of different widths.

    Examples:
        >>> from morlnav.navigation.demonstrations import record_demonstrations
        >>> from morlnav.navigation.modules import CircumnavigationOracle
        >>> from morlnav.navigation.world import SceneSampler
        >>> samplers, oracle = [SceneSampler(num_boxes=boxes) for boxes in (1, 3)], CircumnavigationOracle()
        >>> few, many = (record_demonstrations(oracle, sampler, 1)[0] for sampler in samplers)
        >>> both = join_demonstrations([few, many])
        >>> both["scene", "boxes"].shape[1:], both["episode"].unique().tolist()
        (torch.Size([3, 5]), [0, 1])
    """
    widths = [part["observation"].shape[-1] for part in parts]
    if len(set(widths)) > 1:
        raise ValueError(f"their observations hold {' and '.join(map(str, sorted(set(widths))))} numbers")
    boxes = max(part["scene", "boxes"].shape[-2] for part in parts)
    rewards = {part["next"].get("reward", torch.zeros(0)).shape[-1] for part in parts}
    entries = set.intersection(*(set(part.keys(True, True)) for part in parts))
    entries -= set() if len(rewards) == 1 else {("next", "reward")}
    joined, count = [], 0
    for part in parts:
        part = part.select(*entries).clone()
        _, number = part["episode"].unique(return_inverse=True)
        part["episode"] = number + count
        count += int(number.max()) + 1
        for scene in (part["scene"], part["next"].get("scene", None)):
            if scene is not None:
                missing = boxes - scene["boxes"].shape[-2]
                absent = torch.tensor(ABSENT).expand(len(part), missing, 5)
                scene["boxes"] = torch.cat([scene["boxes"], absent], -2)
        joined.append(part)
    return torch.cat(joined)


def _header(path: Path) -> dict[str, Any]:
    file = path / HEADER
    if not file.is_file():
        raise FileNotFoundError(f"{path} holds no demonstrations: there is no {HEADER}.")
    try:
        header = json.loads(file.read_text(encoding="utf-8-sig"))
        schema, version = header["schema"], header["version"]
        told = header.pop(OF_THE_REST, None)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{file} is damaged: it does not name a schema and a version.") from error
    if (schema, version) != (SCHEMA, VERSION):
        raise ValueError(
            f"{path} holds {schema!r} version {version!r}; this release reads {SCHEMA!r} version {VERSION}."
        )
    settings = header.get("settings", {})
    known = isinstance(settings, dict) and isinstance(settings.get("world", {}), dict) and set(header) <= ENTRIES_TOLD
    if not known or told not in (None, digest(header)):  # the first releases kept no hash of it
        raise ValueError(f"{file} is damaged: it holds other content than was saved.")
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
