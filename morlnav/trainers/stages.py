"""The stages of D-REX (Sec. III-C): demonstrations, their clone, and a reward from its ranked roll-outs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import EnvBase

from morlnav.config import Part, supply
from morlnav.data import ComparedPairs, SnippetPairs, roll_out_ranked
from morlnav.files import write_tensors
from morlnav.limits import check_at_least, check_positive
from morlnav.modules import NormalisedReward, RewardEnsemble
from morlnav.objectives import BehaviourCloningLoss, RankingLoss
from morlnav.trainers.supervised import Fit

Driver = Callable[[Tensor], Tensor]
"""From observations ``[B, D]`` to actions ``[B, A]``, without a preference."""


class Demonstrations(ABC):
    """Where demonstrations come from, and how they are kept.

    Attributes:
        policy: who demonstrated; ``None`` if nobody can be asked.
    """

    policy: Driver | None = None

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
        write_tensors(data, path)

    def load(self, path: Path) -> TensorDict:
        """What :meth:`save` kept."""
        return TensorDict.load_memmap(path).clone()

    def judge(self, clone: Driver, data: TensorDict) -> tuple[dict[str, Any], list[str]]:
        """Facts about a clone that stands in for a demonstrator who cannot be asked, and reasons against it."""
        return {}, []


class Judge(Protocol):
    """Tells whether a learned reward prefers what was demonstrated.

    Attributes:
        required: a reward that fails ends the pipeline.
    """

    required: bool

    def judge(self, reward: nn.Module, demonstrator: Driver, output: Path, **paid: Any) -> object:
        """Write a report into a folder that is made."""

    def read(self, report: Path) -> dict[str, Any]:
        """What such a report says: ``passed``, and ``reasons`` against the reward."""


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
        check_at_least(1, batch_size=batch_size)
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
        burn_in: steps at the beginning of the worse roll-out, where noise has led nowhere yet, that are not compared.
        aggregate: ``"mean"`` or ``"sum"`` over a snippet.
        temperature: a pair's logit is this times the difference.
        batch_size: pairs of an update.
        held_out: share of the roll-outs that is never trained on.
        members: what each member of the ensemble reads.
        reduce: ``"pessimistic"`` or ``"mean"``.
        normalise: stretch the reward so that demonstrated steps are nearly free.
        comparisons: pairs that people compared, a second source of what is better; ``None`` learns from noise alone.

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
        burn_in: int = 20,
        aggregate: Literal["mean", "sum"] = "mean",
        temperature: float = 10.0,
        batch_size: int = 160,
        held_out: float = 0.1,
        members: Sequence[Sequence[str]] = (("observation",),) * 3 + (("observation", "action"),) * 3,
        reduce: Literal["mean", "pessimistic"] = "pessimistic",
        normalise: bool = True,
        comparisons: ComparedPairs | None = None,
    ) -> None:
        check_at_least(1, episodes=episodes, batch_size=batch_size, snippet=snippet)
        check_at_least(0, burn_in=burn_in)
        if burn_in and snippet is None:
            raise ValueError(f"Whole roll-outs (snippet=null) have no burn-in; set burn_in=0, not {burn_in}.")
        if len(levels) < 2 or list(levels) != sorted(set(levels)) or levels[0] < 0:
            raise ValueError(f"levels must be two or more and ascend from 0, got {list(levels)}.")
        if normalise and levels[0] > 0:
            raise ValueError(f"normalise needs roll-outs without noise; begin levels with 0, not {levels[0]}.")
        check_positive(temperature=temperature)
        self.split = max(1, int((1 - held_out) * episodes))
        if not 0 <= held_out < 1 or self.split >= episodes:
            raise ValueError(
                f"held_out={held_out} keeps none of {episodes} episodes per level to choose the reward by; change one."
            )
        if len(members) < (2 if reduce == "pessimistic" else 1):
            raise ValueError(f"The {reduce} ensemble needs more than {len(members)} members.")
        self.noise, self.model, self.fit = noise, model, fit
        self.levels, self.episodes, self.snippet, self.burn_in = list(levels), episodes, snippet, burn_in
        self.aggregate, self.temperature, self.batch_size = aggregate, temperature, batch_size
        self.members, self.reduce, self.normalise = members, reduce, normalise
        self.comparisons = comparisons
        self.key = comparisons.key if comparisons is not None else ""

    def try_parts(self, live: Mapping[str, Any]) -> None:
        """Make noise and models once, to find out what they refuse before anything is rolled out.

        Raises:
            ValueError: for that, and for snippets that, after the burn-in, end beyond an episode.
        """
        if (self.snippet or 1) + self.burn_in > live["max_steps"]:
            raise ValueError(
                f"rewards.ranking.snippet and burn_in must be at most the {live['max_steps']} steps of an episode."
            )
        supply(self.noise, **{**live, "epsilon": torch.tensor(self.levels)})
        for inputs in self.members:
            supply(self.model, **{**live, "inputs": list(inputs)})

    def roll_out(self, clone: Driver, make_env: Callable[[int], EnvBase], live: Mapping[str, Any]) -> TensorDict:
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
        train = SnippetPairs(rollouts[:, : self.split], self.snippet, self.burn_in)
        held_out = SnippetPairs(rollouts[:, self.split :], self.snippet, self.burn_in)
        members = [supply(self.model, **{**live, "inputs": list(inputs)}) for inputs in self.members]
        networks = [TensorDictModule(member, ["observation", "action"], ["reward"]) for member in members]
        loss = RankingLoss(networks, aggregate=self.aggregate, temperature=self.temperature)
        held_out = held_out.sample(512) if self.comparisons is None else self.comparisons.join(held_out.sample(128))

        def sample() -> TensorDict:
            compared = self.comparisons if self.comparisons and torch.rand(()) < self.comparisons.share else None
            return torch.stack([compared.sample() if compared else train.sample(self.batch_size) for _ in members])

        scores = self.fit(loss, sample, held_out, **display)
        model = RewardEnsemble(members, reduce=self.reduce) if len(members) > 1 else members[0]
        if self.normalise:
            mask = rollouts["mask"]
            clean = torch.zeros_like(mask)
            clean[0] = True
            model = NormalisedReward(model).fit(rollouts["observation"][mask], rollouts["action"][mask], clean[mask])
        return model, scores
