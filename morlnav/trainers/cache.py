"""Stages of a pipeline that are kept by what they depend on."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import torch
from filelock import FileLock
from torch import nn

from morlnav.files import digest, sha256
from morlnav.modules import load_module, read_facts, save_module
from morlnav.record.console import stage

T = TypeVar("T")


class Cache:
    """Keeps the results of stages, each named by a hash of its config and of all stages before it.

    Results hold for a seed, a number of threads and a version of the code. Parallel runs wait for one of them. Files
    that have changed since they were kept are refused.

    Args:
        directory: where results go; ``None`` keeps nothing.
        config: by stage, in their order; ``None`` keeps nothing.
        seed: of the run.
        show: whether the terminal shows a line per stage.
        name: of what is learned, for that line.
        trust: classes from outside this package that a result may be made of.

    Examples:
        >>> cache = Cache(tempfile.mkdtemp(), {"env": {}, "clone": {"depth": 3}}, seed=0, show=False)
        >>> from morlnav.modules import Flat
        >>> flat, facts = cache.keep_module("clone", lambda: (Flat(3), {"loss": 0.5}))
        >>> cache.keep_module("clone", lambda: 1 / 0)[1]
        {'loss': 0.5}
    """

    def __init__(
        self,
        directory: str | None,
        config: Mapping[str, Any] | None,
        seed: int,
        show: bool = True,
        name: str = "",
        trust: Collection[str] = (),
    ) -> None:
        self.directory = None if directory is None or config is None else Path(directory)
        self.config, self.seed, self.show, self.name, self.trust = config, seed, show, name, trust

    def digest(self, stage_name: str) -> str | None:
        """What a stage's place in the cache is called: its origin, threads and versions."""
        code = {name: version(name) for name in ("morlnav", "torch")}
        return self.origin(stage_name, threads=torch.get_num_threads(), **code)

    def origin(self, stage_name: str, **more: Any) -> str | None:
        """What a stage's result comes from, wherever and with whatever version it was made."""
        if self.config is None:
            return None
        names = list(self.config)
        content = {name: self.config[name] for name in names[: names.index(stage_name) + 1]} | more
        content["seed"] = self.seed
        return digest(content, default=str)[:12]

    def label(self, stage_name: str) -> str:
        """What a person reads: ``clone``, and ``wide_left/clone`` for an objective of that name."""
        return f"{self.name}/{stage_name}" if self.name else stage_name

    @contextmanager
    def _stage(self, name: str, suffix: str = "", label: str | None = None) -> Iterator[tuple[Path, bool]]:
        with stage(self.label(label or name), self.show) as remark:
            if self.directory is None:
                with tempfile.TemporaryDirectory() as folder:
                    yield Path(folder) / f"{name}{suffix}", False
                return
            path = self.directory / f"{name}-{self.digest(name)}{suffix}"
            path.parent.mkdir(parents=True, exist_ok=True)
            with FileLock(path.with_suffix(".lock")):
                done = path.exists()
                if done:
                    remark("from the cache")
                yield path, done

    def keep(self, name: str, make: Callable[[Path], object], load: Callable[[Path], T]) -> T:
        """The result of a stage, of a folder that is made or found; without a cache the folder goes at once.

        Raises:
            ValueError: if what the cache holds is damaged.
        """
        with self._stage(name) as (path, done):
            if not done:
                _fill(path, make)
            with _refused_if_damaged(path, done):
                _verify(path)
                return load(path)

    def keep_module(
        self, name: str, make: Callable[[], tuple[nn.Module, dict]], label: str | None = None
    ) -> tuple[nn.Module, dict[str, Any]]:
        """A module and facts about it, made or loaded; frozen, in evaluation mode.

        Raises:
            ValueError: if what the cache holds is damaged.
        """
        with self._stage(name, ".pt", label) as (path, done):
            if not done:
                model, facts = make()
                save_module(model, path, facts)
            with _refused_if_damaged(path, done):
                return load_module(path, trust=self.trust), read_facts(path)


def _fill(path: Path, make: Callable[[Path], object]) -> None:
    """Make a folder whole or not at all, and keep its hash beside it."""
    unfinished = path.with_suffix(".part")
    shutil.rmtree(unfinished, ignore_errors=True)  # of a process that was killed
    make(unfinished)
    path.with_suffix(".sha256").write_text(_digest(unfinished))
    unfinished.rename(path)


def _verify(path: Path) -> None:
    kept = path.with_suffix(".sha256")
    if not kept.is_file() or kept.read_text() != _digest(path):
        raise ValueError("its files are not those that were kept")


def _digest(folder: Path) -> str:
    digest = hashlib.sha256()
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(f"{file.relative_to(folder).as_posix()}\0{file.stat().st_size}\0".encode())
        digest.update(bytes.fromhex(sha256(file)))
    return digest.hexdigest()


@contextmanager
def _refused_if_damaged(path: Path, found: bool) -> Iterator[None]:
    try:
        yield
    except (ValueError, FileNotFoundError) as error:
        if not found:
            raise
        reason = str(error).removesuffix(".")
        raise ValueError(f"The cache holds damaged files ({reason}); delete {path}, and they are made anew.") from error
