"""Trained policies: saving and loading them without pickled code, and without what they learned in."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from morlnav.modules.checks import require
from morlnav.modules.saved import load_module, read_facts, save_module
from morlnav.modules.scalarisation import by_name

POLICY_FILE = "policy.pt"
SUM_TOLERANCE = 1e-3
SLACK = 1e-3
"""By how much a measurement may miss its range, in units of 1 plus its own size."""


class Policy(nn.Module):
    """A trained actor: ``policy(observation[..., D], preference[..., n]) -> action[..., A]``.

    For navigation these are raw observations ``[..., 34]`` and actions ``(v, ω)`` in m/s and rad/s. Inputs that make no
    sense are refused: an observation that is not finite or that nothing can measure (where the actor's features tell
    their ``bounds``, such as ±π for a bearing), a preference off the simplex, and what would lead to an action
    that is not finite. Compiled or exported, where nothing can be refused, the policy answers each of them with a stop:
    zeros, for a robot ``v = 0`` and ``ω = 0``.

    Args:
        actor: the network.
        objectives: names of the preference's entries, in order.
        balance: what entries of a preference are multiplied by before the actor is asked, by objective; the preference
            is brought back to its sum. Pure preferences stay what they are; below 1, a style that drowns the others
            makes room for them in between.

    Raises:
        ValueError: if ``balance`` names another objective, or gives one no positive number.

    Examples:
        >>> from morlnav.modules import Actor
        >>> actor = Actor(2, [0.0, -3.14], [0.5, 3.14], features=34)
        >>> policy, observation = Policy(actor, ("distance", "efficiency")), torch.zeros(8, 34)
        >>> policy(observation, torch.tensor([0.5, 0.5])).shape
        torch.Size([8, 2])
        >>> even = Policy(actor, ("distance", "efficiency"), balance={"distance": 0.25})
        >>> same = even(observation, torch.tensor([0.8, 0.2])), policy(observation, torch.tensor([0.5, 0.5]))
        >>> torch.allclose(*same)
        True
    """

    balance: Tensor | None

    def __init__(self, actor: nn.Module, objectives: Sequence[str], balance: Mapping[str, float] | None = None) -> None:
        super().__init__()
        self.actor = actor
        self.objectives = tuple(objectives)
        tell = getattr(getattr(actor, "features", None), "bounds", None)
        limits = tell() if callable(tell) else (torch.tensor([-torch.inf]), torch.tensor([torch.inf]))
        device = next((weight.device for weight in self.parameters()), None)
        for name, limit in zip(("low", "high"), limits, strict=True):
            self.register_buffer(name, limit.to(device), persistent=False)
        numbers = None if balance is None else _numbers(balance, self.objectives).to(device)
        self.register_buffer("balance", numbers, persistent=False)

    def forward(self, observation: Tensor, preference: Tensor) -> Tensor:
        """Actions for observations; the preference broadcasts over them.

        Raises:
            ValueError: if the observation is not finite or out of range, the preference no point of the simplex with
                one entry per objective, or the action not finite.
        """
        silent = torch.compiler.is_compiling() or torch.jit.is_tracing()
        if not silent:
            observation, preference = _as_tensors(observation, preference)
        if preference.ndim == 0 or preference.shape[-1] != len(self.objectives):
            raise ValueError(f"A preference needs {len(self.objectives)} entries {self.objectives}.")
        finite, width = observation.isfinite(), observation.shape[-1]
        fits = len(self.low) in (1, width)  # else the actor says what is wrong
        off = torch.relu(self.low - observation) + torch.relu(observation - self.high) if fits else 0 * observation
        inside = off <= SLACK * (1 + observation.abs())
        point = (preference >= 0).all(-1) & ((preference.sum(-1) - 1).abs() <= SUM_TOLERANCE)  # NaN fails both
        if not silent:
            _refuse(observation, finite, preference, point)
            sentence = "Observations must keep to what can be measured"
            require(inside.all(), sentence, lambda: self._outside(observation, inside))
        if self.balance is not None:
            balanced = self.balance * preference
            preference = balanced / (balanced.sum(-1, keepdim=True) / preference.sum(-1, keepdim=True))
        action = self.actor(observation, preference.expand(*observation.shape[:-1], -1))
        if silent:
            sound = finite.all(-1) & inside.all(-1) & point & action.isfinite().all(-1)
            return torch.where(sound.unsqueeze(-1), action, 0.0)
        require(action.isfinite().all(), "The action must be finite", lambda: f"{action.tolist()} of huge observations")
        return action

    def _outside(self, observation: Tensor, inside: Tensor) -> str:
        """The first entry that is out of its range."""
        entry = int((~inside).nonzero()[0, -1])
        found = observation[~inside][0].item()
        return f"{found:g} in entry {entry}, which goes from {self.low[entry]:.4g} to {self.high[entry]:.4g}"


def _numbers(balance: Mapping[str, float], objectives: Sequence[str]) -> Tensor:
    """A balance for each objective, 1 for those that are not named."""
    if not isinstance(balance, Mapping) or not all(isinstance(number, int | float) for number in balance.values()):
        raise ValueError(f"balance must give numbers by objective, such as {{'demo': 0.3}}, got {balance}.")
    numbers = torch.tensor(by_name({"default": 1.0, **balance}, objectives, "balance"))
    if not ((numbers > 0) & numbers.isfinite()).all():
        raise ValueError(f"balance must be positive and finite, got {dict(balance)}.")
    return numbers


def _as_tensors(observation: Any, preference: Any) -> tuple[Tensor, Tensor]:
    """Tensors of numbers as they are, arrays and lists as tensors; their batches have to fit."""
    given = {"Observations": observation, "Preferences": preference}
    for name, values in given.items():
        try:
            given[name] = torch.as_tensor(values)
        except (TypeError, ValueError, RuntimeError) as error:
            raise ValueError(f"{name} must be a tensor of numbers, got {type(values).__name__}.") from error
        if given[name].dtype is torch.bool or given[name].is_complex():
            raise ValueError(f"{name} must be real numbers, got {str(given[name].dtype).removeprefix('torch.')}.")
    observation, preference = (value if value.is_floating_point() else value.float() for value in given.values())
    rows, weights = observation.shape[:-1], preference.shape[:-1]
    fits = len(weights) <= len(rows) and all(w in (1, r) for w, r in zip(weights[::-1], rows[::-1], strict=False))
    if not observation.ndim or not fits:
        raise ValueError(
            f"Observations [..., D] and preferences [..., n] must fit, got {list(observation.shape)} and "
            f"{list(preference.shape)}."
        )
    return observation, preference


def _refuse(observation: Tensor, finite: Tensor, preference: Tensor, point: Tensor) -> None:
    require(
        finite.all(),
        "Observations must be finite",
        lambda: f"{observation[~finite][0].item()} in entry {int((~finite).nonzero()[0, -1])}",
    )
    require(
        point.all(),
        "The entries of a preference must be at least 0 and add up to 1",
        lambda: str([round(entry, 4) for entry in preference[~point].reshape(-1, preference.shape[-1])[0].tolist()]),
    )


def save(actor: nn.Module, objectives: Sequence[str], directory: str | Path) -> None:
    """Write a policy into a run directory: its weights, and what it is as JSON.

    Raises:
        ValueError: if weights are not finite, or the actor cannot be described.
    """
    save_module(actor, Path(directory) / POLICY_FILE, {"objectives": list(objectives)})


def load(
    directory: str | Path,
    trust: bool | Collection[str] = False,
    device: str = "cpu",
    balance: Mapping[str, float] | None = None,
) -> Policy:
    """Load the policy of a run directory.

    Args:
        directory: where a run wrote its ``policy.pt`` and ``policy.json``.
        trust: also build classes from outside ``morlnav`` that the policy is made of: all, which is only for runs of
            your own, for building a class runs its code; or those of these names.
        device: where to put it, wherever it was trained.
        balance: evens its knob; see :class:`Policy`.

    Returns:
        The averaged actor in evaluation mode.

    Raises:
        FileNotFoundError: if the policy is missing.
        ValueError: if it is made of foreign classes and not trusted, a file is damaged, or ``balance`` does not fit.

    Examples:
        >>> load("results/default").objectives
        ('demo', 'distance', 'efficiency')
    """
    path = Path(directory) / POLICY_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{directory} holds no {POLICY_FILE}: no run has finished there.")
    if not path.with_suffix(".json").is_file():
        raise ValueError(f"{directory} was made by morlnav 0.1, which kept no policy.json; train it again.")
    facts = read_facts(path)
    if not isinstance(facts.get("objectives"), list):
        raise ValueError(f"{path.with_suffix('.json')} is damaged: it names no objectives.")
    return Policy(load_module(path, device, trust), facts["objectives"], balance).eval()
