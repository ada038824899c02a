"""Preference-conditioned actor and vector-valued critic as plain modules on raw observations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn


class ActionBounds(nn.Module):
    """Base of modules that know the action's bounds: maps between actions and the unit cube ``[-1, 1]``.

    Args:
        low: least action, length ``A``.
        high: largest action, length ``A``.

    Raises:
        ValueError: for a bound that is not finite, or a least action that is not below the largest.

    Examples:
        >>> ActionBounds([0.0, -3.0], [0.5, 3.0]).to_unit(torch.tensor([0.5, 0.0]))
        tensor([1., 0.])
    """

    def __init__(self, low: Tensor | Sequence[float], high: Tensor | Sequence[float]) -> None:
        super().__init__()
        self.register_buffer("low", torch.as_tensor(low, dtype=torch.float32))
        self.register_buffer("high", torch.as_tensor(high, dtype=torch.float32))
        check_bounds(self.low, self.high)

    def to_unit(self, action: Tensor) -> Tensor:
        """Actions ``[..., A]`` scaled to ``[-1, 1]``."""
        low, high = (bound[0] if bound.ndim > 1 else bound for bound in (self.low, self.high))  # all alike in a stack
        return 2 * (action - low) / (high - low) - 1

    def to_action(self, unit: Tensor) -> Tensor:
        """Values ``[..., A]`` in ``[-1, 1]`` scaled to actions."""
        return self.low + (unit + 1) * (self.high - self.low) / 2


def check_bounds(low: Tensor, high: Tensor) -> None:
    """That actions can be scaled between a least and a largest one.

    Raises:
        ValueError: for a bound that is not finite, or a least action that is not below the largest.
    """
    if not (low.isfinite().all() and high.isfinite().all()):
        raise ValueError(
            f"Action bounds must be finite, got {low.tolist()} to {high.tolist()}: limit the actions to a range, as "
            "gymnasium.wrappers.RescaleAction does."
        )
    if (low >= high).any():
        raise ValueError("Every lower action bound must be below the upper one.")


class Flat(nn.Module):
    """Features that are the observation itself.

    Args:
        size: length ``D`` of the observation.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.in_features = self.out_features = size

    def config(self) -> dict[str, Any]:
        """The constructor's argument."""
        return {"size": self.out_features}

    def forward(self, observation: Tensor) -> Tensor:
        """The observation ``[..., D]``."""
        return observation


def as_features(features: nn.Module | int) -> nn.Module:
    """The module that a network looks through; a number stands for observations of that length as they are.

    >>> as_features(3)(torch.zeros(2, 3)).shape
    torch.Size([2, 3])
    """
    return features if isinstance(features, nn.Module) else Flat(features)


class Actor(ActionBounds):
    """Deterministic policy ``π(s, λ)``: an MLP with a tanh output, scaled to the action's bounds (Sec. III-B.2).

    Args:
        num_objectives: entries of the preference λ; with 0 the policy is ``π(s)`` and ignores any preference, as the
            behaviour clone does.
        action_low: least action, length ``A``.
        action_high: largest action, length ``A``.
        features: module from observations to features, with ``out_features``; or the length ``D`` of observations
            that are read as they are.
        depth: hidden layers.
        num_cells: neurons per hidden layer.
        preference_scale: λ is multiplied by this first. Above 1, preferences tell the network more apart.

    Raises:
        ValueError: for a negative ``depth`` or less than one neuron.

    Examples:
        >>> actor = Actor(num_objectives=2, action_low=[0.0, -3.14], action_high=[0.5, 3.14], features=34)
        >>> actor(torch.zeros(7, 34), torch.tensor([0.5, 0.5]).expand(7, 2)).shape
        torch.Size([7, 2])
    """

    def __init__(
        self,
        num_objectives: int,
        action_low: Tensor | list[float],
        action_high: Tensor | list[float],
        features: nn.Module | int,
        depth: int = 3,
        num_cells: int = 256,
        preference_scale: float = 1.0,
    ) -> None:
        super().__init__(action_low, action_high)
        self.features = as_features(features)
        self.num_objectives = num_objectives
        self.depth, self.num_cells = depth, num_cells
        self.preference_scale = preference_scale
        inputs = self.features.out_features + num_objectives
        self.mlp = Perceptron(inputs, self.low.numel(), depth, num_cells, gain=0.01)

    def forward(self, observation: Tensor, preference: Tensor | None = None) -> Tensor:
        """Action ``[..., A]`` in its own units for observations ``[..., D]`` and preferences ``[..., n]``."""
        inputs = (self.preference_scale * preference,) if self.num_objectives else ()
        return self.to_action(self.mlp(self.features(observation), *inputs).tanh())

    def config(self) -> dict[str, Any]:
        """The constructor's arguments, as a saved policy keeps them."""
        return {
            "num_objectives": self.num_objectives,
            "action_low": self.low.tolist(),
            "action_high": self.high.tolist(),
            "features": self.features,
            "depth": self.depth,
            "num_cells": self.num_cells,
            "preference_scale": self.preference_scale,
        }


class VectorCritic(ActionBounds):
    """Vector value ``Q(s, a, λ)``, one entry per objective (Sec. III-B).

    Args:
        num_rewards: entries ``m`` of the reward vector.
        num_objectives: entries ``n`` of the preference λ.
        action_low: least action, length ``A``.
        action_high: largest action, length ``A``.
        features: module from observations to features, with ``out_features``; or the length ``D`` of observations
            that are read as they are.
        depth: hidden layers.
        num_cells: neurons per hidden layer.
        preference_scale: λ is multiplied by this first. Above 1, preferences tell the network more apart.
        afterstate: module from observations and actions to more features, with ``out_features``, such as
            :class:`~morlnav.navigation.modules.AfterstateFeatures`.

    Raises:
        ValueError: for a negative ``depth`` or less than one neuron.

    Examples:
        >>> critic = VectorCritic(3, 2, action_low=[0.0, -3.14], action_high=[0.5, 3.14], features=34)
        >>> critic(torch.zeros(7, 34), torch.zeros(7, 2), torch.zeros(7, 2)).shape
        torch.Size([7, 3])
    """

    def __init__(
        self,
        num_rewards: int,
        num_objectives: int,
        action_low: Tensor | list[float],
        action_high: Tensor | list[float],
        features: nn.Module | int,
        depth: int = 3,
        num_cells: int = 256,
        preference_scale: float = 1.0,
        afterstate: nn.Module | None = None,
    ) -> None:
        super().__init__(action_low, action_high)
        self.features = as_features(features)
        self.preference_scale = preference_scale
        self.afterstate = afterstate
        looks = [self.features] if afterstate is None else [self.features, afterstate]
        self.stackable = not any(module.state_dict() for module in looks)  # a loss then needs no vmap for its critics
        inputs = sum(module.out_features for module in looks) + num_objectives + self.low.numel()
        self.mlp = Perceptron(inputs, num_rewards, depth, num_cells, gain=1.0)

    def forward(self, observation: Tensor, preference: Tensor, action: Tensor) -> Tensor:
        """Values ``[..., m]`` for observations ``[..., D]``, preferences ``[..., n]`` and actions ``[..., A]``.

        With parameters of ``k`` critics stacked in front, ``[k, B, m]`` for inputs ``[B, ...]``.
        """
        seen = [self.features(observation)]
        if self.afterstate is not None:
            seen.append(self.afterstate(observation, action))
        return self.mlp(*seen, self.preference_scale * preference, self.to_unit(action))


class StackableLinear(nn.Linear):
    """A linear layer whose parameters may be a stack ``[k, ...]``: then ``k`` layers in one product.

    Attributes:
        dtype: type of the product and of the result, to which inputs and parameters are rounded; that of the parameters
            where it is ``None``. See :func:`round_products`.

    Examples:
        >>> layer, stack = StackableLinear(3, 2), {"weight": torch.randn(4, 2, 3), "bias": torch.randn(4, 2)}
        >>> torch.func.functional_call(layer, stack, torch.randn(5, 3)).shape
        torch.Size([4, 5, 2])
    """

    dtype: torch.dtype | None = None

    def forward(self, inputs: Tensor) -> Tensor:
        """``[..., out]`` of inputs ``[..., in]``; with a stack ``[k, B, out]`` of ``[B, in]`` or ``[k, B, in]``."""
        dtype = self.dtype or self.weight.dtype
        inputs, weight, bias = inputs.to(dtype), self.weight.to(dtype), self.bias.to(dtype)
        if weight.ndim == 2:
            return nn.functional.linear(inputs, weight, bias)
        return torch.baddbmm(bias.unsqueeze(-2), inputs.expand(len(weight), *inputs.shape[-2:]), weight.mT)


class Perceptron(nn.Sequential):
    """ReLU layers that multiply stacks of parameters, initialised orthogonally; several inputs are concatenated.

    Args:
        in_features: length of the inputs together.
        out_features: length of the output.
        depth: hidden layers.
        num_cells: neurons per hidden layer.
        gain: of the last layer's initial weights.

    Raises:
        ValueError: for a negative ``depth`` or less than one neuron.

    Examples:
        >>> Perceptron(5, 2, depth=1, num_cells=8)(torch.zeros(4, 3), torch.zeros(4, 2)).shape
        torch.Size([4, 2])
    """

    def __init__(self, in_features: int, out_features: int, depth: int, num_cells: int, gain: float = 1.0) -> None:
        if depth < 0 or num_cells < 1:
            raise ValueError(
                f"A network needs depth >= 0 and num_cells >= 1, got depth={depth} and num_cells={num_cells}."
            )
        widths = [in_features, *[num_cells] * depth, out_features]
        layers: list[nn.Module] = []
        for inputs, outputs in pairwise(widths):
            layers += [StackableLinear(inputs, outputs), nn.ReLU(inplace=True)]
        super().__init__(*layers[:-1])
        for layer in self.layers:
            nn.init.orthogonal_(layer.weight, gain if layer is self.layers[-1] else math.sqrt(2))
            nn.init.zeros_(layer.bias)

    @property
    def layers(self) -> list[StackableLinear]:
        """The linear layers, first to last."""
        return [layer for layer in self if isinstance(layer, StackableLinear)]

    def forward(self, *inputs: Tensor) -> Tensor:
        """Output ``[..., out]`` for inputs ``[..., in_i]`` whose lengths add up to ``in``."""
        return super().forward(torch.cat(inputs, -1) if len(inputs) > 1 else inputs[0])


def round_products(module: nn.Module, dtype: torch.dtype | None) -> None:
    """Let the hidden layers of every :class:`Perceptron` in ``module`` multiply in a type such as ``torch.bfloat16``.

    The first and the last layer, which see observations and give values, stay exact. Processors made for bfloat16 take
    a part of the time; others may take longer.

    Args:
        module: holds networks made of :class:`StackableLinear` layers, which are changed in place.
        dtype: of the products; ``None`` for exact ones.

    Examples:
        >>> critic = VectorCritic(3, 2, action_low=[0.0, -3.14], action_high=[0.5, 3.14], features=34)
        >>> inputs = torch.rand(7, 34), torch.rand(7, 2), torch.rand(7, 2)
        >>> exact = critic(*inputs)
        >>> round_products(critic, torch.bfloat16)
        >>> bool(torch.allclose(critic(*inputs), exact, rtol=0.05, atol=0.05)), torch.equal(critic(*inputs), exact)
        (True, False)
    """
    for mlp in module.modules():
        if isinstance(mlp, Perceptron):
            for layer in mlp.layers[1:-1]:
                layer.dtype = dtype
