"""A run's directory belongs to one run at a time, and what a killed checkpoint left there is swept up."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from morlnav.files import write_text

LOCK_FILE = ".lock"
TIMES_FILE = "times.json"
PARTS = ("rewards", "learning", "refinement", "evaluation")
"""What takes the time of a run, in this order."""

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
def timed(directory: Path, part: str, goes_on: bool = False) -> Iterator[Callable[[], None]]:
    """Keep the seconds that a part of a run takes, when it ends and whenever the function that this gives is called.

    Args:
        directory: of the run.
        part: one of :data:`PARTS`.
        goes_on: add them to those that were kept before.

    Examples:
        >>> import tempfile
        >>> directory = Path(tempfile.mkdtemp())
        >>> with timed(directory, "learning") as note:
        ...     note()
        >>> times_of(directory)["learning"] < 1
        True
    """
    times, start = times_of(directory), time.monotonic()
    before = times.get(part, 0.0) if goes_on else 0.0

    def note() -> None:
        now = times | {part: round(before + time.monotonic() - start, 2)}
        with suppress(OSError):  # nothing depends on it
            write_text(directory / TIMES_FILE, json.dumps(now, indent=2))

    try:
        yield note
    finally:
        note()


def times_of(directory: Path) -> dict[str, float]:
    """Wall time of the parts of a run in seconds, as far as it is known: nothing where the file is damaged."""
    try:
        times = dict(json.loads((directory / TIMES_FILE).read_text()))
        return {part: float(times[part]) for part in PARTS if part in times}
    except (OSError, ValueError, TypeError, RecursionError):
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
