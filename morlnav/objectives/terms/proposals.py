"""Pulls of the actor toward proposed actions, demonstrators' or random ones, as far as the critic does not object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor, nn

from morlnav.limits import check_at_least
from morlnav.objectives.terms.base import Acted, LossTerm


class Guidance(nn.Module):
    """How strongly a demonstrator's clone draws the actor, near the corner of the objective that it demonstrates.

    A learned reward says what a good path is, but a single action changes its return by less than the critic's error:
    the policy gradient alone stops at a path that is good enough. So the actor is drawn toward the clone's action
    ``a_c(s)``, unless the critic sees a loss of more than ``margin`` in it (after the Q-filter of Nair et al.,
    ICRA 2018), counted over all objectives but the demonstrated one ``i``: that is the clone's own affair, and would
    outweigh a collision that is still a few steps away::

        c·λ_i^p·1[w₋ᵢᵀ(Q(s, a_c, λ) - Q(s, π, λ)) ≥ g - margin]·‖(π - a_c) / h‖²,   h = (high - low) / 2

    Here ``g ≥ 0`` is the gain of the best action that a :class:`Search` has found, if there is one: where something
    clearly better than the actor is known, a clone that is only as good as the actor has nothing to say.

    With ``λ_i = 0`` it is absent; ``p`` keeps it to preferences near the demonstrated corner, for one network serves
    all of them and a strong pull would crowd out the others' gradients.

    Args:
        coefficient: ``c``.
        sharpness: ``p``.
        margin: in units of the scalarised value without the demonstrated objective; below 0 the clone has to be better.

    Raises:
        ValueError: for a negative coefficient or sharpness.

    Examples:
        >>> Guidance(coefficient=0.5, sharpness=1.0, margin=0.1)(torch.tensor([-0.1, -0.2]), torch.tensor([0.5, 0.5]))
        tensor([0.2500, 0.0000])
    """

    def __init__(self, coefficient: float = 0.3, sharpness: float = 4.0, margin: float = 0.08) -> None:
        super().__init__()
        check_at_least(0, coefficient=coefficient, sharpness=sharpness)
        self.coefficient = coefficient
        self.sharpness = sharpness
        self.margin = margin

    def forward(self, gain: Tensor, share: Tensor) -> Tensor:
        """Strength ``[B]`` of the pull toward an action, given what is gained by it and ``λ_i``, both ``[B]``."""
        return self.coefficient * ((gain >= -self.margin) * share**self.sharpness)


class Search(nn.Module):
    """Random actions, toward which the actor is drawn at every preference where they are clearly better.

    The critic judges them by all objectives. That finds what the gradient cannot: where turning left and right are both
    better than what lies between, an actor that sits in the poorer mode stays there, however clearly the critic sees
    the other. Of several ``proposals`` the best one pulls, so that those to both sides do not cancel out::

        c·1[wᵀ(Q(s, a, λ) - Q(s, π, λ)) ≥ -margin]·‖(π - a) / h‖²,   h = (high - low) / 2

    Args:
        coefficient: ``c``.
        margin: in units of the scalarised value; below 0 an action has to be better by so much.
        proposals: how many actions are drawn in each state, of which the one of highest value counts.

    Raises:
        ValueError: for a negative coefficient or no proposal.

    Examples:
        >>> Search(coefficient=1.0, margin=-0.05)(torch.tensor([0.1, 0.0]))
        tensor([1., 0.])
    """

    def __init__(self, coefficient: float = 1.0, margin: float = -0.05, proposals: int = 1) -> None:
        super().__init__()
        check_at_least(0, coefficient=coefficient)
        check_at_least(1, proposals=proposals)
        self.coefficient = coefficient
        self.margin = margin
        self.proposals = proposals

    def propose(self, acted: Acted) -> Tensor:
        """Actions to try in each state, ``[P, B, A]``: drawn uniformly within the bounds."""
        shape = self.proposals, *acted.action.shape
        return acted.low + torch.rand(shape, device=acted.low.device) * (acted.high - acted.low)

    def forward(self, gain: Tensor) -> Tensor:
        """Strength ``[B]`` of the pull toward an action, given what is gained by it, ``[B]``."""
        return self.coefficient * (gain >= -self.margin).to(gain)


class Proposals(LossTerm):
    """A pull of the actor toward the actions of demonstrators' clones, and toward those that a random search finds.

    Each pull is ``strength·‖(π - a) / h‖²`` with the strength of :class:`Guidance` or :class:`Search`; the two know of
    each other, for a clone is silent where the search has found something better.

    Args:
        search: draws actions at every preference; ``None`` leaves it out.
        guidance: how strongly clones pull; ``None`` leaves them out.
        clones: by the objective that it demonstrates, a module that writes an action from entries of the batch. Their
            parameters are frozen.
        objectives: names of the preference's entries, in their order.

    Raises:
        ValueError: for a clone whose name is not among ``objectives``.

    Examples:
        >>> from tensordict.nn import TensorDictModule
        >>> clone = TensorDictModule(nn.Linear(34, 2), ["observation"], ["action"])
        >>> term = Proposals(Search(proposals=4), Guidance(), {"demo": clone}, objectives=["demo", "distance"])
        >>> term.in_keys
        ['observation']
    """

    def __init__(
        self,
        search: Search | None = None,
        guidance: Guidance | None = None,
        clones: Mapping[str, TensorDictModuleBase] | None = None,
        objectives: Sequence[str] = (),
    ) -> None:
        super().__init__()
        self.search = search
        self.guidance = guidance
        self.clones = nn.ModuleDict(clones if guidance is not None else {}).requires_grad_(False)
        if foreign := [name for name in self.clones if name not in objectives]:
            raise ValueError(f"There is a clone for {', '.join(foreign)}, but objectives are {', '.join(objectives)}.")
        self.entries = {name: list(objectives).index(name) for name in self.clones}

    @property
    def in_keys(self) -> list[NestedKey]:
        """What the clones read."""
        return [key for clone in self.clones.values() for key in clone.in_keys]

    @property
    def adds_to(self) -> list[str]:
        """The actor's loss, if there is anything to propose."""
        return ["actor"] if self.search is not None or self.clones else []

    def actor(self, acted: Acted) -> Tensor:
        """Sum ``[B]`` of all pulls."""
        pulls, known = [], 0.0
        if self.search is not None:
            found, gain = self._find(acted)
            known = gain.clamp(min=0)
        for name, clone in self.clones.items():
            action, others = self._ask(acted, name, clone)
            strength = self.guidance(others - known, acted.preference[..., self.entries[name]])
            pulls.append(strength * _distance(acted, action))
        if self.search is not None:
            pulls.append(self.search(gain) * _distance(acted, found))
        return sum(pulls)

    @torch.no_grad()
    def _find(self, acted: Acted) -> tuple[Tensor, Tensor]:
        """The best of the search's actions ``[B, A]``, and the gain ``[B]`` that the critic sees in it."""
        actions = self.search.propose(acted)
        gain, best = acted.scalarise(_gains(acted, actions)).max(0)
        return actions.take_along_dim(best[None, ..., None], 0).squeeze(0), gain

    @torch.no_grad()
    def _ask(self, acted: Acted, name: str, clone: TensorDictModuleBase) -> tuple[Tensor, Tensor]:
        """A clone's action ``[B, A]``, and the gain ``[B]`` that the critic sees in it for the other objectives."""
        action = clone(acted.batch.select(*clone.in_keys)).get(clone.out_keys[0])
        gain = _gains(acted, action.unsqueeze(0)).squeeze(0)
        gain[..., acted.num_static + self.entries[name]] = 0  # what was demonstrated needs no judgement
        return action, acted.scalarise(gain)


def _gains(acted: Acted, actions: Tensor) -> Tensor:
    """What the critic thinks to be gained by other actions ``[P, B, A]``, ``[P, B, m]``."""
    return acted.value_of(actions) - acted.values


def _distance(acted: Acted, action: Tensor) -> Tensor:
    """``‖(π - a) / h‖²``, ``[B]``."""
    return ((acted.action - action) / acted.half_range).square().sum(-1)
