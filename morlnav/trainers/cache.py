"""Stages of a pipeline that are kept by what they depend on."""

from __future__ import annotations

import hashlib
import json
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

from morlnav.modules import load_module, read_facts, save_module
from morlnav.record.progress import stage

T = TypeVar("T")


class Cache:
    """Keeps the results of stages, each named by a hash of its config and of all stages before it.

    Results hold for a seed, a number of threads and a version of the code. Parallel runs wait for one of them.

    Args:
        directory: where results go; ``None`` keeps nothing.
        config: by stage, in their order; ``None`` keeps nothing.
        seed: of the run.
        show: whether the terminal shows a line per stage.
        name: of what is learned, for that line.
        trust: classes from outside this package that a result may be made of.

    Examples:
        >>> cache = Cache(tempfile.mkdtemp(), {"env": {}, "clone": {"depth": 3}}, seed=0, show=False)
        >>> linear, facts = cache.keep_module("clone", lambda: (_example(), {"loss": 0.5}))
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
        return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:12]

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
                if path.exists():
                    remark("from the cache")
                yield path, path.exists()

    def keep(self, name: str, make: Callable[[], T], save: Callable[[T, Path], None], load: Callable[[Path], T]) -> T:
        """The result of a stage, made or loaded."""
        with self._stage(name) as (path, done):
            if done:
                return load(path)
            value = make()
            unfinished = path.with_suffix(".part")
            shutil.rmtree(unfinished, ignore_errors=True)  # of a process that was killed
            save(value, unfinished)
            unfinished.rename(path)
            return load(path)

    def keep_module(
        self, name: str, make: Callable[[], tuple[nn.Module, dict]], label: str | None = None
    ) -> tuple[nn.Module, dict[str, Any]]:
        """A module and facts about it, made or loaded; frozen, in evaluation mode."""
        with self._stage(name, ".pt", label) as (path, done):
            if not done:
                model, facts = make()
                save_module(model, path, facts)
            return load_module(path, trust=self.trust), read_facts(path)

    def keep_folder(self, name: str, make: Callable[[Path], None]) -> Path:
        """A folder of files, made or found; without a cache it lies in a temporary place until the process ends."""
        with self._stage(name) as (path, done):
            if done:
                return path
            unfinished = path.with_suffix(".part")
            shutil.rmtree(unfinished, ignore_errors=True)
            make(unfinished)
            if self.directory is None:
                path = Path(tempfile.mkdtemp()) / name
            unfinished.rename(path) if self.directory is not None else shutil.move(unfinished, path)
            return path


def _example() -> nn.Module:
    from morlnav.modules import Flat

    return Flat(3)
