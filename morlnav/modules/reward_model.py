"""Reward models learned from ranked demonstrations: single, ensembled and normalised, all in [0, 1]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from morlnav.modules.networks import ActionBounds, Perceptron, as_features

INPUTS = (("observation",), ("observation", "action"))
REDUCTIONS = ("mean", "pessimistic")


class RewardModel(ActionBounds):
    """Reward ``R̂(s, a)`` or ``R̂(s)`` in [0, 1]: an MLP with a sigmoid output (Sec. III-C, III-B.2).

    ``R̂(s)`` is the paper's ``-RM`` ablation. It takes an action too, and ignores it, so that all models are called
    alike.

    Args:
        inputs: ``("observation", "action")`` or ``("observation",)``.
        action_low: least action, length ``A``.
        action_high: largest action, length ``A``.
        features: module from observations to features, with ``out_features``; or the length ``D`` of observations
            that are read as they are.
        depth: hidden layers.
        num_cells: neurons per hidden layer.

    Raises:
        ValueError: for other ``inputs``.

    Examples:
        >>> model = RewardModel(("observation",), [-2.0], [2.0], features=3)
        >>> model(torch.zeros(7, 25, 3)).shape
        torch.Size([7, 25])
    """

    def __init__(
        self,
        inputs: Sequence[str],
        action_low: Tensor | Sequence[float],
        action_high: Tensor | Sequence[float],
        features: nn.Module | int,
        depth: int = 3,
        num_cells: int = 128,
    ) -> None:
        super().__init__(action_low, action_high)
        self.inputs = tuple(inputs)
        if self.inputs not in INPUTS:
            raise ValueError(f"A reward model's inputs are {INPUTS[0]} or {INPUTS[1]}, got {self.inputs}.")
        self.features = as_features(features)
        self.depth, self.num_cells = depth, num_cells
        width = self.features.out_features + ("action" in self.inputs) * self.low.numel()
        self.mlp = Perceptron(width, 1, depth, num_cells)

    def forward(self, observation: Tensor, action: Tensor | None = None) -> Tensor:
        """Reward ``[...]`` for observations ``[..., D]`` and actions ``[..., A]`` in their own units.

        Raises:
            ValueError: if the model needs an action and gets none.
        """
        features = [self.features(observation)]
        if "action" in self.inputs:
            if action is None:
                raise ValueError("This reward model reads observation and action; give both.")
            features.append(self.to_unit(action))
        return self.mlp(*features).squeeze(-1).sigmoid()

    def config(self) -> dict[str, Any]:
        """The constructor's arguments, features still as a module."""
        return {
            "inputs": list(self.inputs),
            "action_low": self.low.tolist(),
            "action_high": self.high.tolist(),
            "features": self.features,
            "depth": self.depth,
            "num_cells": self.num_cells,
        }


class RewardEnsemble(nn.Module):
    """Several reward models as one; they may differ in what they read.

    State-only members give the contrast in space, state-action members punish idling; the pessimistic form trusts a
    reward only where the members agree: ``clamp(mean - std, 0, 1)`` with the sample standard deviation.

    Args:
        models: the members, each ``[..., D], [..., A] -> [...]``.
        reduce: ``"mean"`` or ``"pessimistic"``.

    Raises:
        ValueError: for an empty ensemble, one member with ``"pessimistic"``, or an unknown ``reduce``.

    Examples:
        >>> shape = {"action_low": [0.0, -3.14], "action_high": [0.5, 3.14], "features": 34}
        >>> members = [RewardModel(inputs, **shape) for inputs in (["observation"], ["observation", "action"])]
        >>> RewardEnsemble(members, reduce="pessimistic")(torch.zeros(7, 34), torch.zeros(7, 2)).shape
        torch.Size([7])
    """

    def __init__(self, models: Sequence[nn.Module], reduce: str = "mean") -> None:
        super().__init__()
        if reduce not in REDUCTIONS:
            raise ValueError(f"reduce must be one of {', '.join(REDUCTIONS)}, got {reduce}.")
        if len(models) < (2 if reduce == "pessimistic" else 1):
            raise ValueError(f"The {reduce} ensemble needs more than {len(models)} reward models.")
        self.models = nn.ModuleList(models)
        self.reduce = reduce

    def forward(self, observation: Tensor, action: Tensor | None = None) -> Tensor:
        """Reward ``[...]`` for observations ``[..., D]`` and actions ``[..., A]``."""
        rewards = torch.stack([model(observation, action) for model in self.models])
        if self.reduce == "mean":
            return rewards.mean(0)
        return (rewards.mean(0) - rewards.std(0)).clamp(0, 1)

    def config(self) -> dict[str, Any]:
        """The constructor's arguments, members still as modules."""
        return {"models": list(self.models), "reduce": self.reduce}


class NormalisedReward(nn.Module):
    """A reward model stretched so that demonstrated steps are nearly free: ``clamp((R̂ - low) / (high - low), 0, 1)``.

    Bradley-Terry fixes a reward only up to its zero. Left at about 0.55 on the demonstration, ``10·(R̂ - 1)`` charges 5
    per demonstrated step, and shortcuts pay.

    Args:
        model: ``[..., D], [..., A] -> [...]``.
        low: becomes 0.
        high: becomes 1.

    Raises:
        ValueError: unless ``low < high``.

    Examples:
        >>> observation, action, clean = torch.rand(100, 34), torch.rand(100, 2), torch.arange(100) < 50
        >>> model = RewardModel(["observation", "action"], [0.0, -3.14], [0.5, 3.14], features=34)
        >>> model = NormalisedReward(model).fit(observation, action, clean)
        >>> reward = model(observation, action)
        >>> reward[clean].median().item(), reward.min().item()
        (1.0, 0.0)
    """

    def __init__(self, model: nn.Module, low: float = 0.0, high: float = 1.0) -> None:
        super().__init__()
        self.model = model
        self.register_buffer("low", torch.tensor(0.0))
        self.register_buffer("high", torch.tensor(1.0))
        self._set(torch.as_tensor(low), torch.as_tensor(high))

    def forward(self, observation: Tensor, action: Tensor | None = None) -> Tensor:
        """Reward ``[...]`` for observations ``[..., D]`` and actions ``[..., A]``."""
        return ((self.model(observation, action) - self.low) / (self.high - self.low)).clamp(0, 1)

    @torch.no_grad()
    def fit(
        self, observation: Tensor, action: Tensor | None, clean: Tensor, quantile: float = 0.05, chunk: int = 65536
    ) -> NormalisedReward:
        """Set ``low`` to a quantile over all roll-out steps and ``high`` to the median over clean ones.

        Args:
            observation: of all steps of all noise levels, without padding, ``[N, D]``.
            action: of the same steps, ``[N, A]``.
            clean: ``bool`` ``[N]``, true for steps of roll-outs without noise (``ε = 0``).
            quantile: what share of all steps is to earn nothing.
            chunk: steps that the model sees at a time.

        Returns:
            The module itself.

        Raises:
            ValueError: if no step is clean, or the clean steps earn no more than the rest.
        """
        if not clean.any():
            raise ValueError("The normalisation needs steps of roll-outs without noise, got none.")
        parts = [
            self.model(observation[i : i + chunk], None if action is None else action[i : i + chunk])
            for i in range(0, len(observation), chunk)
        ]
        reward = torch.cat(parts)
        self._set(reward.sort().values[int(quantile * (len(reward) - 1))], reward[clean].median())
        return self

    def _set(self, low: Tensor, high: Tensor) -> None:
        if not low < high:
            raise ValueError(
                f"The reward of clean steps must exceed the low end, got {high:.4f} and {low:.4f}; "
                "the model does not rank the demonstration first."
            )
        self.low.copy_(low)
        self.high.copy_(high)

    def config(self) -> dict[str, Any]:
        """The constructor's arguments, the model still as a module."""
        return {"model": self.model, "low": self.low.item(), "high": self.high.item()}
