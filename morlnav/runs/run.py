"""A run directory: its config, and what was trained there."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from morlnav.cli import set_threads
from morlnav.config import build, check, plain
from morlnav.deployment import Policy, load
from morlnav.evaluation import Evaluation
from morlnav.runs.config import CONFIG_FILE, load_config
from morlnav.runs.trust import foreign_targets, refusal
from morlnav.trainers import LearnedReward, Training

OF_THE_COMMAND = ("_recursive_", "threads", "resume", "trust")
"""Keys of a config that say how to train, and not what."""


class Run:
    """What a finished or unfinished training left in a directory.

    Args:
        directory: of the run.
        trust: build classes from outside this package that the config names. Only for runs of your own.
        changes: replace values of the config's ``evaluation``, such as ``{"episodes": 20}``.

    Raises:
        FileNotFoundError: if the directory holds no run.
        ValueError: if its config is damaged, older than this version, or names foreign classes and is not trusted.

    Examples:
        >>> run = Run("results/default")
        >>> run.policy.objectives
        ('demo', 'distance', 'efficiency')
        >>> sorted(run.learned)
        ['demo']
    """

    def __init__(self, directory: str | Path, trust: bool = False, changes: Mapping[str, Any] | None = None) -> None:
        self.directory, self.trust = Path(directory), trust
        self.config = load_config(directory, of_this_version=True)
        if "${" in str(self.config):  # runs are saved resolved, and a resolver could make up a class
            raise ValueError(f"The config of a run holds no interpolation, but that of {directory} does.")
        if not isinstance(self.config.get("evaluation"), dict):
            raise ValueError(f"{self.directory / CONFIG_FILE} is damaged: it names no evaluation.")
        if not trust and (foreign := foreign_targets(self.config)):
            raise ValueError(refusal(foreign[0], "if it is your own, trust it (--trust, or trust=True)"))
        self.config["device"] = "cpu"  # wherever it was trained
        self.config["evaluation"] |= {name: value for name, value in (changes or {}).items() if value is not None}

    @cached_property
    def training(self) -> Training:
        """What was trained."""
        return make_training(self.config)

    @cached_property
    def policy(self) -> Policy:
        """The trained policy."""
        return load(self.directory, self.trust)

    @cached_property
    def learned(self) -> dict[str, LearnedReward]:
        """The rewards that were learned from demonstrations."""
        return self.training.restore_rewards(self.directory)

    @cached_property
    def evaluation(self) -> Evaluation:
        """What measures the policy."""
        return self.training.make_evaluation(self.learned)


def prepare(cfg: DictConfig) -> Training:
    """The training that a composed config names, when what it says to the command itself is checked and done.

    Raises:
        ValueError: in one sentence that names the key, for whatever the config gets wrong.
    """
    for name, kind in {"threads": int, "resume": str | None, "trust": bool}.items():
        check(cfg[name], name, kind=kind)
    set_threads(cfg.threads)
    return make_training(cfg)


def make_training(config: Mapping[str, Any]) -> Training:
    """The training that a config names, at its root.

    Raises:
        ValueError: in one sentence that names the key, for whatever the config gets wrong.
    """
    return build({name: value for name, value in plain(config).items() if name not in OF_THE_COMMAND}, "")
