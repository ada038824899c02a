"""D-REX (Sec. III-C) in any environment: its stages one after another, each cached, and the audit of the rewards."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.envs import EnvBase
from torchrl.record.loggers import Logger

from morlnav.config import classes, supply
from morlnav.limits import check_at_least, check_positive
from morlnav.modules import load_module, read_facts, save_module
from morlnav.trainers.cache import Cache
from morlnav.trainers.live import live_objects
from morlnav.trainers.stages import Cloning, Demonstrations, Driver, Judge, Ranking
from morlnav.transforms import DemonstrationReward

CLONE_FILE = "clone.pt"
REWARD_FILE = "reward.pt"


@dataclass
class LearnedReward:
    """What a demonstration became.

    Attributes:
        transform: pays for it in an environment.
        demonstrator: who drives as demonstrated, from observations ``[B, D]`` to actions ``[B, A]``.
        clone: the network that imitates the demonstrator.
        demonstrations: transitions ``[N]`` that it was learned from; ``None`` where it was restored.
    """

    transform: DemonstrationReward
    demonstrator: Driver | None = None
    clone: nn.Module | None = None
    demonstrations: TensorDict | None = None


class DREX:
    """Learns a reward for every demonstrated objective, and returns them.

    Args:
        demonstrations: by the name of the objective.
        clone: imitates the demonstrator.
        ranking: learns the reward.
        audit: judges it; ``None`` trusts it.
        num: demonstrations of each objective, where they are made.
        scale: the factor ``c_d`` of the reward that an environment pays, ``c_d·(R̂ + b_d)``.
        offset: ``b_d``.
        make_env: makes an environment: ``make_env(num_envs=..., seed=...)``.
        max_steps: time limit of a roll-out.
        seed: of everything that is drawn.
        cache: where stages are kept by what they depend on; ``None`` keeps nothing.
        config: of the environment and of this pipeline, which name the stages in the cache.
        progress_bar: show progress.

    Examples:
        >>> learned = DREX(demonstrations, clone, ranking, make_env=make_env).learn(Path("run"))  # doctest: +SKIP
        >>> env = TransformedEnv(make_env(num_envs=8), learned["demo"].transform)  # doctest: +SKIP
    """

    def __init__(
        self,
        demonstrations: Mapping[str, Demonstrations | None],
        clone: Cloning,
        ranking: Ranking,
        audit: Judge | None = None,
        num: int = 1000,
        scale: float = 10.0,
        offset: float = -1.0,
        *,
        make_env: Callable[..., EnvBase],
        max_steps: int = 250,
        seed: int = 0,
        cache: str | None = None,
        config: Mapping[str, Any] | None = None,
        progress_bar: bool = True,
    ) -> None:
        check_at_least(1, num=num)
        check_positive(scale=scale)
        self.num = num
        self.demonstrations = {name: source for name, source in demonstrations.items() if source is not None}
        self.clone, self.ranking, self.audit = clone, ranking, audit
        self.scale, self.offset, self.seed = scale, offset, seed
        self.make_env, self.progress_bar = make_env, progress_bar
        self.live = live_objects(make_env(num_envs=1)) | {"max_steps": max_steps}
        self.trust = {*classes(clone.actor), *classes(ranking.model)}
        self.stages = {
            name: Cache(
                cache,
                config and _of_one(config, name, source.key, getattr(ranking, "key", "")),
                seed,
                progress_bar,
                name if name != "demo" else "",
                self.trust,
            )
            for name, source in self.demonstrations.items()
        }

    @property
    def names(self) -> list[str]:
        """The demonstrated objectives."""
        return list(self.demonstrations)

    def learn(self, directory: Path | None = None, logger: Logger | None = None) -> dict[str, LearnedReward]:
        """Learn the rewards, and leave them in a run directory.

        Args:
            directory: receives ``reward.pt``, ``clone.pt`` and ``audit/``.
            logger: receives the losses.

        Raises:
            ValueError: if a reward fails its audit, and the audit is required.
        """
        return {name: self._learn(name, place(directory, name), logger) for name in self.demonstrations}

    def _learn(self, name: str, directory: Path | None, logger: Logger | None) -> LearnedReward:
        source, stages = self.demonstrations[name], self.stages[name]
        display = {"logger": logger, "progress_bar": self.progress_bar}
        data, clone = self._imitate(name, **display)
        reward, facts = stages.keep_module(
            "ranking", lambda: self._rank(clone, **display, name=stages.label("reward")), label="reward"
        )
        reasons: list[str] = []
        if source.policy is None:
            judged, reasons = source.judge(clone, data)
            facts |= judged
        if self.audit is not None:
            verdict = self._audit(name, reward, source.policy or clone, reasons, directory)
            facts |= {"audit": verdict}
        if directory is not None:
            save_module(reward, directory / REWARD_FILE, {**facts, "origin": stages.origin("ranking")})
            save_module(clone, directory / CLONE_FILE)
        return self._learned(name, reward, source.policy or clone, clone, data)

    def clones(self) -> list[nn.Module]:
        """The clone of each demonstrator, learned or taken from the cache."""
        return [self._imitate(name, progress_bar=self.progress_bar)[1] for name in self.demonstrations]

    def _imitate(self, name: str, **display: Any) -> tuple[TensorDict, nn.Module]:
        """Demonstrations ``[N]`` of an objective, and a clone of who drove them."""
        source, stages = self.demonstrations[name], self.stages[name]
        data = stages.keep("demonstrations", lambda path: source.save(source.collect(self.num), path), source.load)
        label = stages.label("clone")
        return data, stages.keep_module("clone", lambda: (self._clone(data, **display, name=label), {}))[0]

    def restore(self, directory: Path) -> dict[str, LearnedReward]:
        """The rewards that :meth:`learn` left in a run directory; without clones where they are missing and not asked.

        Raises:
            FileNotFoundError: if one is missing.
            ValueError: if one is damaged.
        """
        return {name: self._restore(name, place(directory, name)) for name in self.demonstrations}

    def _restore(self, name: str, directory: Path) -> LearnedReward:
        policy, origin = self.demonstrations[name].policy, self.stages[name].origin("ranking")
        file, imitator = directory / REWARD_FILE, directory / CLONE_FILE
        if origin is not None and read_facts(file).get("origin") != origin:
            raise ValueError(f"{file} was learned by another config than that of this run.")
        clone = None if policy is not None and not imitator.is_file() else load_module(imitator, trust=self.trust)
        return self._learned(name, load_module(file, trust=self.trust), policy or clone, clone)

    def _learned(
        self, name: str, reward: nn.Module, demonstrator: Driver, clone: nn.Module, data: TensorDict | None = None
    ) -> LearnedReward:
        entry = self.live["num_static"] + self.names.index(name)
        transform = DemonstrationReward(reward, self.scale, self.offset, entry, name)
        return LearnedReward(transform, demonstrator, clone, data)

    def untrained(self) -> dict[str, LearnedReward]:
        """Rewards of nothing, to try whether everything else fits."""
        nothing = {name: lambda observation, action: action[..., 0] * 0 for name in self.demonstrations}
        clone = supply(self.clone.actor, **{**self.live, "num_objectives": 0})
        self.ranking.try_parts(self.live)
        return {name: self._learned(name, reward, clone, clone) for name, reward in nothing.items()}

    def _clone(self, data: TensorDict, **display: Any) -> nn.Module:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)  # the same clone, and the same draws after it, whatever comes from the cache
            return self.clone(data, self.live, **display)

    def _rank(self, clone: Driver, **display: Any) -> tuple[nn.Module, dict[str, Any]]:
        torch.manual_seed(self.seed)
        rollouts = self.ranking.roll_out(
            clone, lambda count: self.make_env(num_envs=count, seed=self.seed + 1), self.live
        )
        model, scores = self.ranking(rollouts, self.live, **display)
        return model, {"held_out": scores}

    def _audit(
        self, name: str, reward: nn.Module, demonstrator: Driver, reasons: list[str], directory: Path | None
    ) -> dict[str, Any]:
        def judge(path: Path) -> None:
            self.audit.judge(
                reward, demonstrator, path, scale=self.scale, offset=self.offset, snippet=self.ranking.snippet or 25
            )

        def read(report: Path) -> dict[str, Any]:
            if directory is not None:
                shutil.copytree(report, directory / "audit", dirs_exist_ok=True)
            return self.audit.read(report)

        verdict = self.stages[name].keep("audit", judge, read)
        reasons = [*reasons, *verdict["reasons"]]
        if reasons and self.audit.required:
            where = f" See {directory / 'audit'};" if directory is not None else ""
            raise ValueError(
                f"The learned reward fails its audit ({reasons[0]}{where}); change the pipeline, or train on this "
                f"reward with rewards.audit.required=false."
            )
        return verdict


def place(directory: Path | None, name: str) -> Path | None:
    """Where a run keeps reward, audit and clone of an objective: ``demo`` in the run directory, others below it."""
    return directory if directory is None or name == "demo" else directory / "styles" / name


def _of_one(config: Mapping[str, Any], name: str, key: str, compared: str) -> dict[str, Any]:
    """The config as one objective depends on it, stage by stage."""
    pipeline = config["rewards"]
    return {
        "env": config["env"],
        "demonstrations": [pipeline["demonstrations"][name], pipeline.get("num"), key],
        "clone": pipeline["clone"],
        "ranking": [pipeline["ranking"], compared] if compared else pipeline["ranking"],
        "audit": {key: pipeline.get(key) for key in ("audit", "scale", "offset")},
    }
