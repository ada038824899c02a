"""All jobs of a sweep are checked before the first one trains."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, ClassVar

from hydra import compose
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from morlnav.cli import one_sentence_errors
from morlnav.runs.directory import removed_if_empty
from morlnav.runs.run import prepare


class Sweeps(Callback):
    """Hears of a sweep before its first job: a value that a later one would be refused for is told at once.

    This holds for Hydra's own sweeper; others choose values by what came out before.
    """

    folder: ClassVar[Path | None] = None

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Rehearse every job, and remember the folder, in which Hydra soon writes what the sweep is of."""
        Sweeps.folder = Path(config.hydra.sweep.dir)
        if config.hydra.sweeper._target_.endswith("BasicSweeper"):
            with one_sentence_errors():  # its exit alone leaves a callback of Hydra's
                words = [f"{key}={value}" for key, value in (config.hydra.sweeper.params or {}).items()]
                parsed = OverridesParser.create().parse_overrides([*words, *config.hydra.overrides.task])
                for job in BasicSweeper.split_arguments(parsed, None)[0]:
                    try:
                        with tempfile.TemporaryDirectory() as scratch:
                            prepare(compose(config.hydra.job.config_name, job)).rehearse(Path(scratch))
                    except ValueError as error:
                        raise ValueError(f"{' '.join(job)}: {error}") from error

    @classmethod
    def forget_refused(cls) -> None:
        """Remove the folder if no job has left anything in it."""
        folder, cls.folder = cls.folder, None
        if folder is not None and [path.name for path in folder.glob("*")] == ["multirun.yaml"]:
            with removed_if_empty(folder):
                (folder / "multirun.yaml").unlink()
