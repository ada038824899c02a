"""Preference-conditioned actor and vector-valued critic as plain modules on raw observations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.modules import MLP

from morlnav.objectives.bounds import check_bounds


class NavigationFeatures(nn.Module):
    """Bring a raw observation ``[..., 34]`` to numbers of order one, by default ``[..., 68]``.

    Bearings become sine and cosine, so that straight behind is no jump; distances are given linearly and by a term
    that resolves the last decimetres, where contact is decided.

    Args:
        observe_human: whether the observation holds the human's distance and bearing.
        lidar_range: range of the lidar in metres.
        sectors: number of lidar sectors.
        use_lidar: whether the lidar is looked at.
        octaves: Fourier features of the distances to goal and human with this many wavelengths, 16 m, 8 m, ...
            (Tancik et al., NeurIPS 2020). An MLP on the bare distance learns its fine structure late.

    Examples:
        >>> NavigationFeatures()(torch.zeros(5, 34)).shape
        torch.Size([5, 68])
        >>> NavigationFeatures(use_lidar=False, octaves=4)(torch.zeros(5, 34)).shape
        torch.Size([5, 24])
    """

    longest = 16.0
    """Longest wavelength of the Fourier features in metres."""

    def __init__(
        self,
        observe_human: bool = True,
        lidar_range: float = 4.0,
        sectors: int = 30,
        use_lidar: bool = True,
        octaves: int = 0,
    ) -> None:
        super().__init__()
        self.observe_human = observe_human
        self.lidar_range = lidar_range
        self.sectors = sectors
        self.use_lidar = use_lidar
        self.octaves = octaves
        self.in_features = 2 + 2 * observe_human + sectors
        self.out_features = (4 + 2 * octaves) * (1 + observe_human) + 2 * sectors * use_lidar

    def config(self) -> dict[str, Any]:
        """The constructor's arguments, as plain values."""
        return {
            name: getattr(self, name) for name in ("observe_human", "lidar_range", "sectors", "use_lidar", "octaves")
        }

    def forward(self, observation: Tensor) -> Tensor:
        """Map observations in metres and radians to features.

        Raises:
            ValueError: if the last dimension does not fit.
        """
        if observation.shape[-1] != self.in_features:
            raise ValueError(f"Expected observations [..., {self.in_features}], got {tuple(observation.shape)}.")
        known = 2 * (1 + self.observe_human)
        distance, bearing = observation[..., :known].unflatten(-1, (-1, 2)).unbind(-1)
        shares = distance * torch.exp2(torch.arange(distance.shape[-1], device=distance.device)) / 6 - 1  # 6 m and 3 m
        features = [torch.stack([shares, (-distance).exp(), bearing.sin(), bearing.cos()], -1)]
        if self.octaves:
            frequencies = torch.exp2(torch.arange(self.octaves, device=distance.device)) * (2 * math.pi / self.longest)
            phase = distance.unsqueeze(-1) * frequencies
            features += [phase.sin(), phase.cos()]
        features = torch.cat(features, -1).flatten(-2)
        if not self.use_lidar:
            return features
        lidar = observation[..., known:]
        return torch.cat([features, 1 - 2 * lidar / self.lidar_range, nearness(lidar)], -1)


def nearness(distance: Tensor) -> Tensor:
    """A number that resolves the last decimetres of a distance in metres: 2.7 at contact, 0 at 0.9 m."""
    return 0.3 / (distance + 0.1) - 0.3


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


class Actor(ActionBounds):
    """Deterministic policy ``π(s, λ)``: an MLP with a tanh output, scaled to the action's bounds (Sec. III-B.2).

    Args:
        num_preferences: entries of the preference λ; with 0 the policy is ``π(s)`` and ignores any preference, as the
            behaviour clone does.
        action_low: least action, length ``A``.
        action_high: largest action, length ``A``.
        features: module from observations to features, with ``out_features``; :class:`NavigationFeatures` by default.
        depth: hidden layers.
        num_cells: neurons per hidden layer.
        preference_scale: λ is multiplied by this first. Above 1, preferences tell the network more apart.

    Raises:
        ValueError: for a negative ``depth`` or less than one neuron.

    Examples:
        >>> actor = Actor(num_preferences=2, action_low=[0.0, -3.14], action_high=[0.5, 3.14])
        >>> actor(torch.zeros(7, 34), torch.tensor([0.5, 0.5]).expand(7, 2)).shape
        torch.Size([7, 2])
    """

    def __init__(
        self,
        num_preferences: int,
        action_low: Tensor | list[float],
        action_high: Tensor | list[float],
        features: nn.Module | None = None,
        depth: int = 4,
        num_cells: int = 256,
        preference_scale: float = 1.0,
    ) -> None:
        super().__init__(action_low, action_high)
        self.features = features if features is not None else NavigationFeatures()
        self.num_preferences = num_preferences
        self.preference_scale = preference_scale
        self.mlp = _mlp(self.features.out_features + num_preferences, self.low.numel(), depth, num_cells, gain=0.01)

    def forward(self, observation: Tensor, preference: Tensor | None = None) -> Tensor:
        """Action ``[..., A]`` in its own units for observations ``[..., D]`` and preferences ``[..., n]``."""
        inputs = (self.preference_scale * preference,) if self.num_preferences else ()
        return self.to_action(self.mlp(self.features(observation), *inputs).tanh())


class VectorCritic(ActionBounds):
    """Vector value ``Q(s, a, λ)``, one entry per objective (Sec. III-B).

    Args:
        num_objectives: entries of the reward vector.
        num_preferences: entries of the preference λ.
        action_low: least action, length ``A``.
        action_high: largest action, length ``A``.
        features: module from observations to features, with ``out_features``; :class:`NavigationFeatures` by default.
        depth: hidden layers.
        num_cells: neurons per hidden layer.
        preference_scale: λ is multiplied by this first. Above 1, preferences tell the network more apart.
        afterstate: module from observations and actions to more features, with ``out_features``, such as
            :class:`~morlnav.modules.AfterstateFeatures`.

    Raises:
        ValueError: for a negative ``depth`` or less than one neuron.

    Examples:
        >>> critic = VectorCritic(3, 2, action_low=[0.0, -3.14], action_high=[0.5, 3.14])
        >>> critic(torch.zeros(7, 34), torch.zeros(7, 2), torch.zeros(7, 2)).shape
        torch.Size([7, 3])
    """

    def __init__(
        self,
        num_objectives: int,
        num_preferences: int,
        action_low: Tensor | list[float],
        action_high: Tensor | list[float],
        features: nn.Module | None = None,
        depth: int = 4,
        num_cells: int = 256,
        preference_scale: float = 1.0,
        afterstate: nn.Module | None = None,
    ) -> None:
        super().__init__(action_low, action_high)
        self.features = features if features is not None else NavigationFeatures()
        self.preference_scale = preference_scale
        self.afterstate = afterstate
        looks = [self.features] if afterstate is None else [self.features, afterstate]
        self.stackable = not any(module.state_dict() for module in looks)  # a loss then needs no vmap for its critics
        inputs = sum(module.out_features for module in looks) + num_preferences + self.low.numel()
        self.mlp = _mlp(inputs, num_objectives, depth, num_cells, gain=1.0)

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


def round_products(module: nn.Module, dtype: torch.dtype | None) -> None:
    """Let the hidden layers of every MLP in ``module`` multiply in ``dtype``, such as ``torch.bfloat16``.

    The first and the last layer, which see observations and give values, stay exact. Processors made for bfloat16 take
    a part of the time; others may take longer.

    Args:
        module: holds networks made of :class:`StackableLinear` layers, which are changed in place.
        dtype: of the products; ``None`` for exact ones.

    Examples:
        >>> critic = VectorCritic(3, 2, action_low=[0.0, -3.14], action_high=[0.5, 3.14])
        >>> inputs = torch.rand(7, 34), torch.rand(7, 2), torch.rand(7, 2)
        >>> exact = critic(*inputs)
        >>> round_products(critic, torch.bfloat16)
        >>> bool(torch.allclose(critic(*inputs), exact, rtol=0.05, atol=0.05)), torch.equal(critic(*inputs), exact)
        (True, False)
    """
    for mlp in module.modules():
        if isinstance(mlp, MLP):
            for layer in [layer for layer in mlp if isinstance(layer, StackableLinear)][1:-1]:
                layer.dtype = dtype


def _mlp(in_features: int, out_features: int, depth: int, num_cells: int, gain: float) -> MLP:
    if depth < 0 or num_cells < 1:
        raise ValueError(f"A network needs depth >= 0 and num_cells >= 1, got depth={depth} and num_cells={num_cells}.")
    mlp = MLP(
        in_features,
        out_features,
        depth=depth,
        num_cells=num_cells,
        activation_class=nn.ReLU,
        activation_kwargs={"inplace": True},
        layer_class=StackableLinear,
    )
    linear = [layer for layer in mlp if isinstance(layer, nn.Linear)]
    for layer in linear:
        nn.init.orthogonal_(layer.weight, gain if layer is linear[-1] else math.sqrt(2))
        nn.init.zeros_(layer.bias)
    return mlp
