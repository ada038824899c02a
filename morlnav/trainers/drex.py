"""D-REX (Sec. III-C) in any environment: demonstrations, clone, ranked roll-outs, reward, audit; each stage cached."""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.record.loggers import Logger

from morlnav.config import Part, classes, supply
from morlnav.data import SnippetPairs, roll_out_ranked
from morlnav.modules import NormalisedReward, RewardEnsemble, load_module, read_facts, save_module
from morlnav.objectives import BehaviourCloningLoss, RankingLoss
from morlnav.trainers.cache import Cache
from morlnav.trainers.live import live_objects
from morlnav.trainers.supervised import Fit
from morlnav.transforms import DemonstrationReward

CLONE_FILE = "clone.pt"
REWARD_FILE = "reward.pt"
Policy = Callable[[Tensor], Tensor]


class Demonstrations(ABC):
    """Where demonstrations come from, and how they are kept.

    Attributes:
        policy: who demonstrated, from observations ``[B, D]`` to actions ``[B, A]``; ``None`` if nobody can be asked.
    """

    policy: Policy | None = None

    key: str = ""
    """What they depend on beyond their config, such as a hash of files."""

    @abstractmethod
    def collect(self, num: int) -> TensorDict:
        """Transitions ``[N]`` with ``observation``, ``action`` (the label) and ``episode``, which counts from 0.

        Args:
            num: episodes that are wanted, where they are made.
        """

    def save(self, data: TensorDict, path: Path) -> None:
        """Keep them in a folder."""
        data.memmap(path, copy_existing=True)

    def load(self, path: Path) -> TensorDict:
        """What :meth:`save` kept."""
        return TensorDict.load_memmap(path).clone()

    def judge(self, clone: Policy, data: TensorDict) -> tuple[dict[str, Any], list[str]]:
        """Facts about a clone that stands in for a demonstrator who cannot be asked, and reasons against it."""
        return {}, []


class Cloning:
    """Behaviour cloning of the demonstrations.

    Args:
        actor: the network, from observations to actions.
        fit: how it is trained.
        loss_function: ``"l2"`` or ``"smooth_l1"``.
        batch_size: rows of an update.
        held_out: share of the episodes that is never trained on, from 0 to 1.

    Raises:
        ValueError: for numbers out of range.
    """

    def __init__(
        self,
        actor: Part[nn.Module],
        fit: Fit,
        loss_function: Literal["l2", "smooth_l1"] = "l2",
        batch_size: int = 512,
        held_out: float = 0.05,
    ) -> None:
        if batch_size < 1:
            raise ValueError(f"batch_size must be at least 1, got {batch_size}.")
        if not 0 <= held_out < 1:
            raise ValueError(f"held_out must be from 0 to below 1, got {held_out}.")
        self.actor, self.fit = actor, fit
        self.loss_function, self.batch_size, self.held_out = loss_function, batch_size, held_out

    def __call__(self, data: TensorDict, live: Mapping[str, Any], **display: Any) -> nn.Module:
        """A clone of whoever drove ``data`` ``[N]``, in evaluation mode."""
        actor = supply(self.actor, **{**live, "num_objectives": 0})
        loss = BehaviourCloningLoss(
            TensorDictModule(actor, ["observation"], ["action"]),
            bounds=(torch.tensor(live["action_low"]), torch.tensor(live["action_high"])),
            loss_function=self.loss_function,
        )
        rows, count = data.select("observation", "action"), int(data["episode"].max()) + 1
        last = data["episode"] >= max(1, int((1 - self.held_out) * count))
        train, held_out = rows[~last], rows[last] if count > 1 else rows
        self.fit(loss, lambda: train[torch.randint(len(train), (self.batch_size,))], held_out, **display)
        return actor.eval()


class Ranking:
    """A reward from roll-outs of the clone, ranked by the noise on its actions.

    Args:
        noise: on the clone's actions, called with levels ``epsilon`` ``[B]``.
        model: a reward model, made once for each member with what it reads as ``inputs``.
        fit: how the models are trained.
        levels: of the noise, ascending.
        episodes: roll-outs per level.
        snippet: steps that are compared; ``None`` compares whole roll-outs.
        aggregate: ``"mean"`` or ``"sum"`` over a snippet.
        temperature: a pair's logit is this times the difference.
        batch_size: pairs of an update.
        held_out: share of the roll-outs that is never trained on.
        members: what each member of the ensemble reads.
        reduce: ``"pessimistic"`` or ``"mean"``.
        normalise: stretch the reward so that demonstrated steps are nearly free.

    Raises:
        ValueError: for numbers out of range, or values that contradict each other.
    """

    def __init__(
        self,
        noise: Part[nn.Module],
        model: Part[nn.Module],
        fit: Fit,
        levels: Sequence[float] = (0.0, 0.06, 0.12, 0.18, 0.24, 0.3, 0.36, 0.42, 0.48, 0.54, 0.6),
        episodes: int = 200,
        snippet: int | None = 5,
        aggregate: Literal["mean", "sum"] = "mean",
        temperature: float = 10.0,
        batch_size: int = 160,
        held_out: float = 0.1,
        members: Sequence[Sequence[str]] = (("observation",),) * 3 + (("observation", "action"),) * 3,
        reduce: Literal["mean", "pessimistic"] = "pessimistic",
        normalise: bool = True,
    ) -> None:
        for name, value in {"episodes": episodes, "batch_size": batch_size, "snippet": snippet or 1}.items():
            if value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}.")
        if snippet == 0:
            raise ValueError("snippet must be at least 1, or null for whole roll-outs, got 0.")
        if len(levels) < 2 or list(levels) != sorted(set(levels)) or levels[0] < 0:
            raise ValueError(f"levels must be two or more and ascend from 0, got {list(levels)}.")
        if normalise and levels[0] > 0:
            raise ValueError(f"normalise needs roll-outs without noise; begin levels with 0, not {levels[0]}.")
        if temperature <= 0:
            raise ValueError(f"temperature must be positive, got {temperature}.")
        self.split = max(1, int((1 - held_out) * episodes))
        if not 0 <= held_out < 1 or self.split >= episodes:
            raise ValueError(
                f"held_out={held_out} keeps none of {episodes} episodes per level to choose the reward by; change one."
            )
        if len(members) < (2 if reduce == "pessimistic" else 1):
            raise ValueError(f"The {reduce} ensemble needs more than {len(members)} members.")
        self.noise, self.model, self.fit = noise, model, fit
        self.levels, self.episodes, self.snippet = list(levels), episodes, snippet
        self.aggregate, self.temperature, self.batch_size = aggregate, temperature, batch_size
        self.members, self.reduce, self.normalise = members, reduce, normalise

    def try_parts(self, live: Mapping[str, Any]) -> None:
        """Make noise and models once, to find out what they refuse before anything is rolled out."""
        supply(self.noise, **{**live, "epsilon": torch.zeros(1)})
        for inputs in self.members:
            supply(self.model, **{**live, "inputs": list(inputs)})

    def roll_out(self, clone: Policy, make_env: Callable[[int], EnvBase], live: Mapping[str, Any]) -> TensorDict:
        """The clone under every noise level, ``[levels, episodes, T]``."""
        return roll_out_ranked(
            clone,
            make_env,
            lambda levels: supply(self.noise, **{**live, "epsilon": levels}),
            self.levels,
            self.episodes,
            live["max_steps"],
        )

    def __call__(self, rollouts: TensorDict, live: Mapping[str, Any], **display: Any) -> tuple[nn.Module, dict]:
        """The reward model, and its held-out scores."""
        train = SnippetPairs(rollouts[:, : self.split], self.snippet)
        held_out = SnippetPairs(rollouts[:, self.split :], self.snippet).sample(512)
        members = [supply(self.model, **{**live, "inputs": list(inputs)}) for inputs in self.members]
        networks = [TensorDictModule(member, ["observation", "action"], ["reward"]) for member in members]
        loss = RankingLoss(networks, aggregate=self.aggregate, temperature=self.temperature)
        scores = self.fit(
            loss, lambda: torch.stack([train.sample(self.batch_size) for _ in members]), held_out, **display
        )
        model = RewardEnsemble(members, reduce=self.reduce) if len(members) > 1 else members[0]
        if self.normalise:
            mask = rollouts["mask"]
            clean = torch.zeros_like(mask)
            clean[0] = True
            model = NormalisedReward(model).fit(rollouts["observation"][mask], rollouts["action"][mask], clean[mask])
        return model, scores


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
    demonstrator: Policy | None = None
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
        audit: Any = None,
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
        if num < 1:
            raise ValueError(f"num must be at least 1, got {num}.")
        if scale <= 0:
            raise ValueError(f"scale must be positive, got {scale}.")
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
                config and _of_one(config, name, source.key),
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
        data = stages.keep("demonstrations", lambda: source.collect(self.num), source.save, source.load)
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
        self, name: str, reward: nn.Module, demonstrator: Policy, clone: nn.Module, data: TensorDict | None = None
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

    def _rank(self, clone: Policy, **display: Any) -> tuple[nn.Module, dict[str, Any]]:
        torch.manual_seed(self.seed)
        rollouts = self.ranking.roll_out(
            clone, lambda count: self.make_env(num_envs=count, seed=self.seed + 1), self.live
        )
        model, scores = self.ranking(rollouts, self.live, **display)
        return model, {"held_out": scores}

    def _audit(
        self, name: str, reward: nn.Module, demonstrator: Policy, reasons: list[str], directory: Path | None
    ) -> dict[str, Any]:
        def judge(path: Path) -> None:
            self.audit.judge(
                reward, demonstrator, path, scale=self.scale, offset=self.offset, snippet=self.ranking.snippet or 25
            )

        report = self.stages[name].keep_folder("audit", judge)
        verdict = self.audit.read(report)
        if directory is not None:
            shutil.copytree(report, directory / "audit", dirs_exist_ok=True)
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


def _of_one(config: Mapping[str, Any], name: str, key: str) -> dict[str, Any]:
    """The config as one objective depends on it, stage by stage."""
    pipeline = config["rewards"]
    return {
        "env": config["env"],
        "demonstrations": [pipeline["demonstrations"][name], pipeline.get("num"), key],
        "clone": pipeline["clone"],
        "ranking": pipeline["ranking"],
        "audit": {key: pipeline.get(key) for key in ("audit", "scale", "offset")},
    }
