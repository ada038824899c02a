"""A demonstrator's clone as a guide of the actor, as far as the critic does not object."""

from __future__ import annotations

from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn


class Guidance(nn.Module):
    """A pull toward proposed actions on replayed states with a Q-filter, by one entry ``λ_i`` of λ or none.

    A learned reward says what a good path is, but a single action changes its return by less than the critic's error:
    the policy gradient alone stops at a path that is good enough. The guide proposes an action ``a_g(s)``, and the
    actor is drawn toward it unless one of the critics sees a loss of more than ``margin`` in it (after the Q-filter of
    Nair et al., ICRA 2018), counted over all objectives but the guided one: that is the guide's own affair, and would
    outweigh a collision that is still a few steps away::

        c·λ_i^p·1[min_k w₋ᵢᵀ(Q_k(s, a_g, λ) - Q_k(s, π, λ)) ≥ g - margin]·‖(π - a_g) / h‖²,   h = (high - low) / 2

    Here ``g ≥ 0`` is the gain of the best action that a search beside it has found, if there is one: where something
    clearly better than the actor is known, a guide that is only as good as the actor has nothing to say.

    With ``λ_i = 0`` it is absent; ``p`` keeps it to preferences near the guided corner, for one network serves all of
    them and a strong pull would crowd out the others' gradients.

    Without an ``entry`` it acts at every preference, and the critics' mean judges it by all objectives. A guide that
    draws random actions with a negative margin then finds what the gradient cannot: where turning left and right are
    both better than what lies between, an actor that sits in the poorer mode stays there, however clearly both critics
    see the other. Of several ``proposals`` the best one pulls, so that proposals to both sides do not cancel out.

    Args:
        guide: writes an action from entries of the batch, such as the behaviour clone; its parameters are frozen.
        entry: index ``i`` of the guided objective among the preference's entries; ``None`` for no objective's own.
        coefficient: ``c``.
        sharpness: ``p``.
        margin: in units of the scalarised value without the guided objective; below 0 the guide has to be better.
        proposals: how many actions the guide is asked for in each state, of which the one of highest value counts.

    Raises:
        ValueError: for a negative coefficient, sharpness or entry, or no proposal.

    Examples:
        >>> import torch
        >>> from tensordict.nn import TensorDictModule
        >>> guide = TensorDictModule(lambda observation: observation[..., :2], ["observation"], ["action"])
        >>> guidance = Guidance(guide, entry=0, coefficient=0.5, sharpness=1.0)
        >>> guidance(torch.tensor([[1.0, 1.0]]), torch.tensor([0.1]), torch.tensor([[0.5, 0.5]]))
        tensor([0.5000])
    """

    def __init__(
        self,
        guide: TensorDictModuleBase,
        entry: int | None = 0,
        coefficient: float = 0.3,
        sharpness: float = 4.0,
        margin: float = 0.1,
        proposals: int = 1,
    ) -> None:
        super().__init__()
        if coefficient < 0 or sharpness < 0:
            raise ValueError(
                f"Coefficient and sharpness of the guidance must not be negative, got {coefficient} and {sharpness}."
            )
        if entry is not None and entry < 0:
            raise ValueError(f"The guided entry is counted from the front, from 0 on, got {entry}.")
        if proposals < 1:
            raise ValueError(f"The guide has to propose at least one action, got {proposals} proposals.")
        self.guide = guide.requires_grad_(False)
        self.entry = entry
        self.coefficient = coefficient
        self.sharpness = sharpness
        self.margin = margin
        self.proposals = proposals

    def forward(self, apart: Tensor, gain: Tensor, preference: Tensor) -> Tensor:
        """Penalty ``[...]`` of actions that are ``apart`` ``[..., A]`` from the guide's, in half ranges.

        Args:
            apart: with a gradient.
            gain: scalarised value of the guide's action less that of the actor's, without ``λ_i``'s part and less the
                gain ``g`` of what a search found, ``[...]``.
            preference: ``[..., n]``.
        """
        followed = (gain >= -self.margin).to(apart)
        if self.entry is not None:
            followed = followed * preference[..., self.entry] ** self.sharpness
        return self.coefficient * followed * apart.square().sum(-1)
