"""Files that are whole or not there, and hashes that tell whether they still are what was written."""

from __future__ import annotations

import errno
import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tensordict import TensorDictBase

BLOCK = 4096
"""Bytes of disk that the smallest file takes."""


def sha256(path: Path) -> str:
    """The SHA-256 of a file's content.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "empty"
    >>> path.touch()
    >>> sha256(path)[:8]
    'e3b0c442'
    """
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def digest(content: Any, default: Callable[[Any], Any] | None = None) -> str:
    """The SHA-256 of what JSON can hold, whatever the order of its keys; ``default`` tells what to make of the rest.

    >>> digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    True
    """
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=default).encode()).hexdigest()


def write_text(path: Path, text: str) -> None:
    """Write a text file at once: whoever is killed meanwhile leaves what was there before.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "config.yaml"
    >>> write_text(path, "seed: 0")
    >>> [file.name for file in path.parent.iterdir()]
    ['config.yaml']
    """
    _replace(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file at once, or not at all.

    PyTorch's own writers end the process without a word on a full disk; so they write into memory first.

    Raises:
        OSError: if the disk has too little room.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "policy.pt2"
    >>> write_bytes(path, b"whole")
    >>> path.read_bytes()
    b'whole'
    """
    require_room(path.parent, len(content) + BLOCK)
    _replace(path, content)


def _replace(path: Path, content: bytes) -> None:
    unfinished = path.with_name(f"{path.name}.part")
    try:
        unfinished.write_bytes(content)
        unfinished.replace(path)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise


def require_room(folder: Path, needed: int, advice: str = "make room and begin again") -> None:
    """Refuse to write more than a disk can hold: a memory-mapped file that outgrows it kills without a word.

    Args:
        folder: where files are to go; it must exist.
        needed: bytes.
        advice: what to do about it.

    Raises:
        OSError: if there is less room.

    Examples:
        >>> require_room(Path("."), 10**18)  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        OSError: The disk of . has ... MB free, but 1000000000000.0 MB are needed; make room and begin again.
    """
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise OSError(
            f"The disk of {folder} has {free / 1e6:.1f} MB free, but {needed / 1e6:.1f} MB are needed; {advice}."
        )


def write_tensors(data: TensorDictBase, path: Path) -> None:
    """Write tensors into a new folder, each as a memory-mapped file.

    Raises:
        OSError: if the disk has too little room.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    leaves = data.values(include_nested=True, leaves_only=True)
    require_room(path.parent, sum(leaf.nbytes + BLOCK for leaf in leaves) + 16 * BLOCK)
    data.memmap(path, copy_existing=True)


def is_full(error: BaseException) -> bool:
    """Whether the system refused to write for lack of room.

    >>> is_full(OSError(errno.ENOSPC, "No space left on device")), is_full(OSError())
    (True, False)
    """
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
