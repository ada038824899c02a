"""A run's directory belongs to one run at a time, and what a killed checkpoint left there is swept up."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from morlnav.files import write_text

LOCK_FILE = ".lock"
TIMES_FILE = "times.json"
UNFINISHED = ("stage", "archive", "delete", "backup")
"""What TorchRL adds to a checkpoint's name while it writes, replaces or removes one."""


@contextmanager
def reserved(directory: Path) -> Iterator[None]:
    """Keep other runs out of a directory; the operating system ends this with the process, however that ends.

    Raises:
        ValueError: if another run is at work there.

    Examples:
        >>> import tempfile
        >>> directory = Path(tempfile.mkdtemp(), "run")
        >>> with reserved(directory):
        ...     [path.name for path in directory.iterdir()]
        ['.lock']
        >>> list(directory.iterdir())
        []
    """
    directory.mkdir(parents=True, exist_ok=True)
    lock = FileLock(directory / LOCK_FILE, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise ValueError(f"Another run is at work in {directory}; wait for it, or choose another directory.") from None
    try:
        yield
    finally:
        with suppress(OSError):  # Windows removes no open file
            (directory / LOCK_FILE).unlink()  # while it is held, so that nobody's lock is taken away
        lock.release()


@contextmanager
def timed(directory: Path, part: str) -> Iterator[None]:
    """Add the seconds that a part of a run takes to those it has taken before an interruption.

    Examples:
        >>> import tempfile
        >>> directory = Path(tempfile.mkdtemp())
        >>> with timed(directory, "learning"):
        ...     pass
        >>> list(times_of(directory))
        ['learning']
    """
    start = time.monotonic()
    try:
        yield
    finally:
        times = times_of(directory)
        write_text(directory / TIMES_FILE, json.dumps(times | {part: times.get(part, 0.0) + time.monotonic() - start}))


def times_of(directory: Path) -> dict[str, float]:
    """Wall time of every part of a run in seconds; empty where none is known, or the file is damaged."""
    try:
        return {str(part): float(seconds) for part, seconds in json.loads((directory / TIMES_FILE).read_text()).items()}
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return {}


def remove_leftovers(directory: Path) -> None:
    """Remove what is left of checkpoints that were being written, replaced or removed when a run was killed.

    A checkpoint that was put aside for a new one which never came takes its place again.

    Args:
        directory: of the run.

    Examples:
        >>> import tempfile
        >>> directory = Path(tempfile.mkdtemp())
        >>> (directory / "checkpoints" / ".checkpoint-000000000256.stage-0a1b").mkdir(parents=True)
        >>> (directory / "checkpoints" / ".checkpoint-000000000128.backup-2c3d").mkdir()
        >>> remove_leftovers(directory)
        >>> [path.name for path in (directory / "checkpoints").iterdir()]
        ['checkpoint-000000000128']
    """
    for path in (directory / "checkpoints").glob(".checkpoint-*.*-*"):
        checkpoint, _, rest = path.name[1:].rpartition(".")
        kind = rest.partition("-")[0]
        if kind == "backup" and not path.with_name(checkpoint).exists():
            path.rename(path.with_name(checkpoint))
        elif kind in UNFINISHED:
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


@contextmanager
def removed_if_empty(directory: Path) -> Iterator[None]:
    """Hydra makes the directory before a config can be refused; what was refused leaves nothing."""
    try:
        yield
    finally:
        with suppress(OSError):
            os.removedirs(os.path.relpath(directory))
