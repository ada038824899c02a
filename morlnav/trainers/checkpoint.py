"""Checkpoints that are whole or refused: what is written is listed with hashes, and only what is listed is read."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import torch
from torch.utils._pytree import tree_leaves
from torchrl.checkpoint import Checkpoint, CheckpointError
from torchrl.data import PrioritizedSampler, ReplayBuffer
from torchrl.trainers.trainers import Trainer

from morlnav.files import BLOCK, digest, require_room, sha256

LISTING = "files.json"
SUFFIXES = (".json", ".memmap")  # text and bare numbers, in which no code can hide
ROOM_FOR_TEXT = 2**21  # bytes; the JSON files of a run take a quarter of it


class ListedCheckpoint(Checkpoint):
    """TorchRL's checkpoint, complete or not there: free space is checked before, and its files are listed after.

    ``files.json`` holds size and SHA-256 of every other file. It is written before the checkpoint gets its name.

    Args:
        components: as for :class:`torchrl.checkpoint.Checkpoint`.

    Examples:
        >>> import tempfile
        >>> saved = ListedCheckpoint(net=torch.nn.Linear(2, 1)).save(Path(tempfile.mkdtemp()) / "checkpoint-1")
        >>> verify(saved)
        >>> _ = (saved / "manifest.json").write_text("{}")
        >>> verify(saved)  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        torchrl.checkpoint._checkpoint.CheckpointError: .../manifest.json is damaged: 2 bytes, expected ...
    """

    def save(self, path: str | Path, **settings: Any) -> Path:
        """Write a checkpoint.

        Raises:
            OSError: if the disk has too little room. Nothing was written then.
            ValueError: if a component writes files of a kind that :func:`verify` refuses.
        """
        folder = Path(path).absolute().parent
        folder.mkdir(parents=True, exist_ok=True)
        for unfinished in folder.glob(".*.stage-*"):  # of a process that was killed while it wrote
            shutil.rmtree(unfinished, ignore_errors=True)
        require_room(folder, self._needed_bytes(), "make room and resume, what was saved before is intact")
        return super().save(path, **settings)

    def _needed_bytes(self) -> int:
        tensors, trees = [], 0
        for component in self.components.values():
            if isinstance(component, ReplayBuffer):
                tensors += component.storage[:].values(include_nested=True, leaves_only=True)
                if isinstance(component.sampler, PrioritizedSampler):  # its sums and minima, as float64
                    trees += 2 * 8 * component.storage.max_size
            elif hasattr(component, "state_dict"):
                tensors += [leaf for leaf in tree_leaves(component.state_dict()) if isinstance(leaf, torch.Tensor)]
        return sum(tensor.nbytes + BLOCK for tensor in tensors) + trees + ROOM_FOR_TEXT

    @staticmethod
    def _publish_path(source: Path, destination: Path) -> None:
        """TorchRL's last step, which gives a complete checkpoint its name."""
        (source / LISTING).write_text(_listing(_hashes(source)))
        Checkpoint._publish_path(source, destination)


def load_checkpoint(trainer: Trainer, path: str | Path) -> Path:
    """Put a trainer where a checkpoint left off; where that one is damaged, the one before it.

    Args:
        trainer: of the same config as the one that wrote the checkpoint.
        path: the checkpoint.

    Returns:
        The checkpoint that was loaded.

    Raises:
        CheckpointError: if it and all that came before it are damaged. Nothing was loaded then.
        ValueError: if there are links or files that could hold code among its files. Nothing was loaded then.
    """
    checkpoint = whole_checkpoint(path)
    trainer.load_from_file(checkpoint)
    return checkpoint


def whole_checkpoint(path: str | Path) -> Path:
    """This checkpoint if it is whole, or else the newest one before it that is, which is said on the terminal.

    Raises:
        CheckpointError, ValueError: see :func:`load_checkpoint`.
    """
    path, damages = Path(path), []
    for candidate in [path, *reversed([other for other in rotation(path.parent) if _step(other) < _step(path)])]:
        try:
            verify(candidate)
        except CheckpointError as damage:
            damages.append(str(damage))
            continue
        if damages:
            print(f"{'; '.join(damages)}; going on from {candidate} instead.")
        return candidate
    raise CheckpointError(f"{'; '.join(damages)}; no whole checkpoint is left there, and nothing was loaded.")


def find_checkpoints(path: Path) -> list[Path]:
    """The checkpoint at a path, or those of the run at that path, oldest first; none may be there. Nothing is read."""
    if (path / "checkpoints").is_dir():
        return rotation(path / "checkpoints")
    is_one = _step(path) >= 0 or (path / "manifest.json").is_file() or (path / LISTING).is_file()
    return [path] if path.exists() and is_one else []


def rotation(folder: Path) -> list[Path]:
    """What is named as TorchRL names checkpoints, oldest first, be it damaged or not a checkpoint at all."""
    named = (path for path in folder.glob("checkpoint-*") if _step(path) >= 0)
    return sorted(named, key=lambda path: (_step(path), path.name))


def _step(path: Path) -> int:
    match = re.fullmatch(r"checkpoint-(\d+)(\.torchrl)?", path.name)
    return int(match[1]) if match else -1


def verify(path: str | Path) -> None:
    """Check that a checkpoint holds what was written, and nothing else; its files are read, but not understood.

    Raises:
        CheckpointError: if a file was changed, deleted or added.
        ValueError: if it is not a plain folder, or holds a link or a file that could hold code.
    """
    path, name = Path(path), Path(path) / LISTING
    _files(path)  # before anything is read: whoever adds a file can also list it
    if not name.is_file():
        raise CheckpointError(f"{name} is missing, so that nothing tells whether the checkpoint is whole")
    text = name.read_bytes()
    try:
        listed = dict(json.loads(text)["files"])
        if text != _listing(listed).encode() or not all(isinstance(entry, dict) for entry in listed.values()):
            raise ValueError
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise CheckpointError(f"{name} is damaged: expected a listing of the checkpoint's files") from error
    found = _hashes(path)
    for file in sorted(listed.keys() | found.keys()):
        if listed.get(file) != found.get(file):
            raise CheckpointError(f"{path / file} {_what_is_wrong(listed.get(file), found.get(file))}")
    Checkpoint.manifest(path)  # or else TorchRL takes it for one of its older kinds, which hold pickles


def _what_is_wrong(listed: dict[str, Any] | None, found: dict[str, Any] | None) -> str:
    if found is None:
        return "is missing"
    if listed is None:
        return f"does not belong to its checkpoint: {LISTING} does not list it"
    if listed.get("size") != found["size"]:
        return f"is damaged: {found['size']} bytes, expected {listed.get('size')}"
    return "is damaged: other content than was written"


def _hashes(path: Path) -> dict[str, dict[str, Any]]:
    """Size in bytes and SHA-256 of every file but the listing itself, by its place in the checkpoint."""
    hashes = {}
    for file in _files(path):
        if file != path / LISTING:
            hashes[file.relative_to(path).as_posix()] = {"size": file.stat().st_size, "sha256": sha256(file)}
    return hashes


def _listing(files: dict[str, dict[str, Any]]) -> str:
    """The listing as text, with a hash of its own."""
    return json.dumps({"files": files, "sha256": digest(files)}, indent=1, sort_keys=True)


def _files(folder: Path) -> list[Path]:
    """All files of a checkpoint, none of them opened.

    Raises:
        ValueError: if one of them is a link, or neither a folder nor a file of a kind that we write.
    """
    if folder.is_symlink() or not folder.is_dir():
        raise ValueError(
            f"{folder} is {_kind(folder)}, but a checkpoint is a plain folder of {' and '.join(SUFFIXES)} files alone."
        )
    files = []
    for path in sorted(folder.iterdir()):
        if path.suffix in SUFFIXES and path.is_file() and not path.is_symlink():
            files.append(path)
        else:
            files += _files(path)
    return files


def _kind(path: Path) -> str:
    if path.is_symlink():
        return "a link"
    if path.suffix in (".pkl", ".pickle"):
        return "a pickle"
    if path.suffix in (".zip", ".tdz", ".torchrl"):
        return "an archive"
    return "a file of another kind" if path.is_file() else "neither a folder nor a file"
