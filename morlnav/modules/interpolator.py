"""The preference interpolator: from a preference λ to the direction λ_p that its value vector should take."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize

from morlnav.limits import check_at_least
from morlnav.modules.scalarisation import LinearScalarisation
from morlnav.simplex import simplex_grid


class PreferenceInterpolator(nn.Module):
    """PD-MORL's interpolator (Sec. III-B): radial basis functions through the value directions of key preferences.

    Each key preference has a key value, the return vector that a policy was measured to reach under it. The directions
    (unit vectors) of these values are interpolated with a linear kernel and a constant, as
    ``scipy.interpolate.RBFInterpolator(kernel="linear")`` does, and the result is normalised again. Before the first
    :meth:`update` the value of a preference is taken to be its own scalarisation weights, which are ``[1, ..., 1, λ]``
    unless others are given.

    :meth:`update` keeps the keys current. A measured value that scores higher at a key's weights than the stored one
    replaces it, whichever preference reached it: PD-MORL's ratchet. A ratchet alone remembers one lucky evaluation for
    ever, so a key that was measured again and not surpassed is drawn toward the best fresh value,
    ``stored = fresh + decay * (stored - fresh)``. ``decay=1`` is PD-MORL's rule, in which keys never decay.

    Values keep their signs: rewards that are costs have negative entries, and so have their directions.

    Args:
        num_objectives: objectives ``n`` that a preference weighs.
        num_static: rewards in front whose weight is always 1 (the baseline); value vectors have ``m = num_static + n``
            entries.
        preferences: key preferences ``[K, n]``; by default ``simplex_grid(num_objectives, steps)``.
        values: key values ``[K, m]``, unscaled; the interpolator is then ready at once.
        steps: steps of the default grid.
        decay: share of its lead that a stored value keeps when it is measured again and not surpassed, in (0, 1].
        weights: maps preferences ``[..., n]`` and ``m`` to weights ``[..., m]``, such as the loss's scalarisation; by
            default the paper's ``[1, ..., 1, λ]``.

    Raises:
        ValueError: if ``preferences`` or ``values`` have the wrong shape, a key preference occurs twice, ``num_static``
            is negative or ``decay`` is not in (0, 1].

    Examples:
        >>> interpolator = PreferenceInterpolator(2, steps=1)
        >>> interpolator(torch.tensor([0.6, 0.8]))  # not ready: the direction of the weights (1, 0.6, 0.8)
        tensor([0.7071, 0.4243, 0.5657])
        >>> corners = torch.tensor([[0.0, 1.0], [1.0, 0.0]])
        >>> interpolator.update(corners, torch.tensor([[3.0, -4.0, 0.0], [3.0, 0.0, -4.0]]))
        tensor([True, True])
        >>> interpolator(corners)
        tensor([[ 0.6000, -0.8000,  0.0000],
                [ 0.6000,  0.0000, -0.8000]])
    """

    preferences: Tensor
    values: Tensor
    coefficients: Tensor
    ready: Tensor

    def __init__(
        self,
        num_objectives: int,
        num_static: int = 1,
        preferences: Tensor | Sequence[Sequence[float]] | None = None,
        values: Tensor | Sequence[Sequence[float]] | None = None,
        steps: int = 4,
        decay: float = 0.9,
        weights: Callable[[Tensor, int], Tensor] | None = None,
    ) -> None:
        super().__init__()
        grid = simplex_grid(num_objectives, steps) if preferences is None else torch.as_tensor(preferences)
        keys = grid.detach().clone() if grid.is_floating_point() else grid.float()
        if keys.ndim != 2 or keys.shape[-1] != num_objectives:
            raise ValueError(f"preferences must have the shape [K, {num_objectives}], got {tuple(keys.shape)}.")
        if repeated := len(keys) - len(keys.unique(dim=0)):
            raise ValueError(f"Each key preference must occur once, got {repeated} of {len(keys)} repeated.")
        check_at_least(0, num_static=num_static)
        if not 0 < decay <= 1:
            raise ValueError(f"decay must be above 0 and at most 1, got {decay}.")
        self.num_static = num_static
        self.decay = decay
        self.num_entries = num_static + num_objectives
        self.weights = weights if weights is not None else LinearScalarisation()
        own = self.weights(keys, self.num_entries)
        start = own if values is None else torch.as_tensor(values).detach().to(keys, copy=True)
        shape = (len(keys), self.num_entries)
        if start.shape != shape:
            raise ValueError(f"values must have the shape {shape}, got {tuple(start.shape)}.")
        self.register_buffer("preferences", keys)
        self.register_buffer("values", start)
        self.register_buffer("coefficients", keys.new_zeros(len(keys) + 1, start.shape[-1]))
        self.register_buffer("ready", torch.tensor(values is not None, device=keys.device))
        self._fit()

    def tuneable(self) -> PreferenceInterpolator:
        """A new one of the tuneable entries alone, with directions ``[..., n]``.

        >>> PreferenceInterpolator(2).tuneable()(torch.tensor([0.6, 0.8]))
        tensor([0.6000, 0.8000])
        """
        values = self.values[:, self.num_static :] if self.ready else None
        return PreferenceInterpolator(
            self.preferences.shape[1], 0, self.preferences, values, decay=self.decay, weights=self.weights
        )

    def forward(self, preference: Tensor) -> Tensor:
        """Unit value directions ``[..., m]`` of the preferences ``[..., n]``."""
        direction = self.coefficients[-1] - _distances(preference, self.preferences) @ self.coefficients[:-1]
        return normalize(torch.where(self.ready, direction, self.weights(preference, self.num_entries)), dim=-1)

    @torch.no_grad()
    def update(self, preferences: Tensor, values: Tensor) -> Tensor:
        """Takes in evaluation results, and refits.

        Args:
            preferences: evaluated preferences ``[E, n]``; they need not be keys.
            values: mean returns measured under them ``[E, m]``, unscaled. Results that are not finite are left out.

        Returns:
            Bool ``[K]``: the keys whose value was replaced by a better one.

        Raises:
            ValueError: if the shapes do not match each other and the keys, or there is no result.
        """
        (_, n), (_, m) = self.preferences.shape, self.values.shape
        if preferences.shape[1:] != (n,) or values.shape != (len(preferences), m) or not len(preferences):
            shapes = f"{tuple(preferences.shape)} and {tuple(values.shape)}"
            raise ValueError(f"preferences and values must have the shapes [E, {n}] and [E, {m}], got {shapes}.")
        preferences, values = preferences.to(self.preferences), values.to(self.values)
        valid = values.isfinite().all(-1)
        weights = self.weights(self.preferences, self.num_entries)
        scores = (weights @ values.nan_to_num().mT).masked_fill(~valid, -torch.inf)
        score, best = scores.max(-1)
        fresh = values.nan_to_num()[best]
        measured = (_distances(self.preferences, preferences) < 1e-4) & valid

        raised = ((weights * self.values).sum(-1) < score) | (~self.ready & valid.any())
        decayed = fresh + self.decay * (self.values - fresh)
        kept = torch.where(measured.any(-1, keepdim=True), decayed, self.values)
        self.values.copy_(torch.where(raised.unsqueeze(-1), fresh, kept))
        self.ready.logical_or_(valid.any())
        self._fit()
        return raised

    def _fit(self) -> None:
        """Solves for the kernel coefficients and the constant; in double precision, which costs nothing here."""
        keys, directions = self.preferences.double(), normalize(self.values.double(), dim=-1)
        system = keys.new_ones(len(keys) + 1, len(keys) + 1)
        system[:-1, :-1] = -_distances(keys, keys)
        system[-1, -1] = 0
        targets = torch.cat([directions, directions.new_zeros(1, directions.shape[-1])])
        self.coefficients.copy_(torch.linalg.solve(system, targets))


def _distances(preferences: Tensor, others: Tensor) -> Tensor:
    """Euclidean distances ``[..., K]`` of ``[..., n]`` to ``[K, n]``, exact for close points too."""
    rows = preferences.reshape(-1, preferences.shape[-1])
    distances = torch.cdist(rows, others, compute_mode="donot_use_mm_for_euclid_dist")
    return distances.reshape(*preferences.shape[:-1], len(others))
