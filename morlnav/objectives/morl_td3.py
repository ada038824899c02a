"""MORL-TD3: twin delayed deterministic policy gradients with vector-valued, preference-conditioned critics."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Literal

import torch
from tensordict import TensorDict, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModule, dispatch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import TensorSpec
from torchrl.envs.utils import step_mdp
from torchrl.objectives.utils import distance_loss

from morlnav.limits import check_at_least
from morlnav.modules.scalarisation import LinearScalarisation
from morlnav.objectives.actor_critic import VectorActorCriticLoss
from morlnav.objectives.terms.base import Acted, Judged, LossTerm

LOSS_FUNCTIONS = ("l2", "l1", "smooth_l1")


class MORLTD3Loss(VectorActorCriticLoss):
    """Losses of MORL-TD3 (Sec. III-B) for any number of objectives, and what further terms add to them.

    With weights ``w(λ) = [1, …, λ]`` and terms ``t``, such as the angle of Eq. 1::

        y        = r + γ·Q_k(s', ã, λ),   k = argmin_i wᵀQ_i(s', ã, λ)   (the whole vector of one twin)
        L_critic = Σ_i ℓ(Q_i(s, a, λ), y) + Σ_t t.critic(Q_i)
        L_actor  = -wᵀQ_1(s, π(s, λ), λ) + Σ_t t.actor(π, Q_1)

    It stands where :class:`torchrl.objectives.TD3Loss` would, with its keys, metadata and target parameters.

    Args:
        actor_network: writes ``action`` from ``observation`` and ``preference``.
        qvalue_network: writes ``state_action_value`` ``[..., m]``. One module is copied ``num_qvalue_nets`` times with
            weights drawn uniformly from its range, which suits uniformly initialised weights alone; a list or
            ``ModuleList`` of modules keeps their own, as does a critic that is the only one. Where the wrapped module
            has a true ``stackable``, it is called once with all parameters stacked, instead of ``vmap``.
        action_spec: bounded spec of the action; or give ``bounds``.
        bounds: ``(low, high)`` of the action, finite; exactly one of the two.
        num_qvalue_nets: number of critics.
        policy_noise: standard deviation of the target's smoothing noise, in units of half the action range.
        noise_clip: the noise is clipped to this, in the same units.
        loss_function: ``"l2"``, ``"l1"`` or ``"smooth_l1"``.
        scalarisation: maps ``(λ, m)`` to weights; :class:`LinearScalarisation` by default.
        terms: what else the losses hold, by the name under which it is reported; see
            :class:`~morlnav.objectives.terms.LossTerm`.

    Raises:
        ValueError: for missing, contradictory or infinite action bounds, an unknown ``loss_function``, negative noise,
            no critic, or a list of other than ``num_qvalue_nets`` different critics.
        TypeError: for a term that is no ``LossTerm``.

    Examples:
        >>> from morlnav.modules import Actor, VectorCritic
        >>> from morlnav.objectives.terms import AngleTerm
        >>> low, high = torch.tensor([0.0, -3.14]), torch.tensor([0.5, 3.14])
        >>> actor = TensorDictModule(Actor(2, low, high, features=34), ["observation", "preference"], ["action"])
        >>> critic = VectorCritic(3, 2, low, high, features=34)
        >>> critic = TensorDictModule(critic, ["observation", "preference", "action"], ["state_action_value"])
        >>> loss = MORLTD3Loss(actor, critic, bounds=(low, high), terms={"angle": AngleTerm(actor=0.05)})
        >>> batch = TensorDict(
        ...     observation=torch.randn(8, 34), preference=torch.full((8, 2), 0.5), action=torch.rand(8, 2),
        ...     next=dict(observation=torch.randn(8, 34), preference=torch.full((8, 2), 0.5), reward=torch.randn(8, 3),
        ...               done=torch.zeros(8, 1, dtype=torch.bool), terminated=torch.zeros(8, 1, dtype=torch.bool)),
        ...     batch_size=[8],
        ... )
        >>> sorted(loss(batch).keys())[:3]
        ['angle_actor', 'loss_actor', 'loss_qvalue']
    """

    out_keys = [  # noqa: RUF012  (the class attribute TorchRL defines)
        "loss_actor",
        "loss_qvalue",
        "pred_value",
        "state_action_value_actor",
        "next_state_value",
        "target_value",
    ]

    def __init__(
        self,
        actor_network: TensorDictModule,
        qvalue_network: TensorDictModule | list[TensorDictModule] | nn.ModuleList,
        *,
        action_spec: TensorSpec | None = None,
        bounds: tuple[Tensor | float, Tensor | float] | None = None,
        num_qvalue_nets: int = 2,
        policy_noise: float = 0.1,
        noise_clip: float = 0.5,
        loss_function: Literal["l2", "l1", "smooth_l1"] = "l2",
        scalarisation: nn.Module | None = None,
        terms: Mapping[str, LossTerm | None] | None = None,
    ) -> None:
        if loss_function not in LOSS_FUNCTIONS:
            raise ValueError(f"loss_function must be one of {', '.join(LOSS_FUNCTIONS)}, got {loss_function}.")
        check_at_least(1, num_qvalue_nets=num_qvalue_nets)
        check_at_least(0, policy_noise=policy_noise, noise_clip=noise_clip)
        terms = {name: term for name, term in (terms or {}).items() if term is not None}
        for name, term in terms.items():
            if not isinstance(term, LossTerm):
                raise TypeError(f"terms must be LossTerms, got {type(term).__name__} for '{name}'.")
        super().__init__(actor_network, qvalue_network, num_qvalue_nets, action_spec, bounds)
        self.policy_noise = policy_noise
        self.noise_clip = noise_clip
        self.loss_function = loss_function
        self.scalarisation = scalarisation if scalarisation is not None else LinearScalarisation()
        self.terms = nn.ModuleDict(terms)
        for term in terms.values():
            term.attach(self.scalarisation)
        reported = [f"{name}_{loss}" for name, term in self.terms.items() for loss in term.adds_to]
        self.out_keys = [*self.out_keys, *reported]

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of the actor and its metadata; the critic that it climbs gets no gradient."""
        acted = self._acted(tensordict)
        loss = -acted.scalarise(acted.values)
        penalties = {f"{name}_actor": t.actor(acted) for name, t in self.terms.items() if "actor" in t.adds_to}
        loss, reports = _add(loss, penalties)
        return self._reduced(loss, tensordict), {"state_action_value_actor": acted.values.detach(), **reports}

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of the critics and its metadata; ``td_error`` is ``[num_qvalue_nets, B]``, summed over objectives."""
        target, next_value = self._target(tensordict)
        value = self.values(tensordict, self.qvalue_network_params)
        loss = distance_loss(value, target.expand_as(value), loss_function=self.loss_function).sum(-1)
        judged = Judged(tensordict, *self._weigh(tensordict, value), value)
        penalties = {f"{name}_qvalue": t.critic(judged) for name, t in self.terms.items() if "qvalue" in t.adds_to}
        loss, reports = _add(loss, penalties)
        metadata = {
            "td_error": (value - target).detach().pow(2).sum(-1),
            "next_state_value": next_value,
            "pred_value": value.detach(),
            "target_value": target,
        }
        return self._reduced(loss.sum(0), tensordict), metadata | reports

    @torch.no_grad()
    def _target(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Target vectors ``y`` and bootstrapped values, both ``[B, m]``."""
        following = self.act(step_mdp(tensordict), self.target_actor_network_params)
        action = following.get(self.tensor_keys.action)
        noise = (torch.randn_like(action) * self.policy_noise).clamp(-self.noise_clip, self.noise_clip)
        half_range = (self.max_action - self.min_action) / 2
        action = (action + noise * half_range).clamp(self.min_action, self.max_action)
        twins = self.values(following.set(self.tensor_keys.action, action), self.target_qvalue_network_params)
        _, weights = self._weigh(following, twins)
        smaller = (weights * twins).sum(-1).argmin(0)
        next_value = twins.take_along_dim(smaller[None, ..., None], 0).squeeze(0)
        return self.bootstrap(tensordict, next_value), next_value

    def _acted(self, tensordict: TensorDictBase) -> Acted:
        """The actor's actions, and the critic that it climbs."""
        acted = self.act(tensordict, self.actor_network_params)
        first = self.qvalue_network_params.detach()[:1]
        values = self.values(acted, first).squeeze(0)
        return Acted(
            tensordict,
            *self._weigh(tensordict, values),
            values,
            action=acted.get(self.tensor_keys.action),
            low=self.min_action,
            high=self.max_action,
            value_of=partial(self._values_of, acted, first),
        )

    def _values_of(self, acted: TensorDictBase, first: TensorDictBase, actions: Tensor) -> Tensor:
        """Value vectors ``[P, B, m]`` of other actions ``[P, B, A]`` in the same states."""
        return self.values(acted.expand(actions.shape[:-1]).set(self.tensor_keys.action, actions), first).squeeze(0)

    def _weigh(self, tensordict: TensorDictBase, values: Tensor) -> tuple[Tensor, Tensor]:
        """Preferences ``[B, n]`` and their weights ``[B, m]`` of the entries of values ``[..., m]``."""
        preference = tensordict.get(self.tensor_keys.preference)
        return preference, self.scalarisation(preference, values.shape[-1])

    def _reduced(self, loss: Tensor, tensordict: TensorDictBase) -> Tensor:
        weights = self._maybe_get_priority_weight(tensordict)
        return self._reduce_loss(loss, tensordict=tensordict, weights=weights)

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Both losses and their metadata; writes the priority of every sample into ``tensordict``."""
        loss_actor, actor_metadata = self.actor_loss(tensordict)
        loss_qvalue, value_metadata = self.value_loss(tensordict)
        tensordict.set(self.tensor_keys.priority, value_metadata.pop("td_error").max(0)[0])
        return TensorDict(loss_actor=loss_actor, loss_qvalue=loss_qvalue, **actor_metadata, **value_metadata)

    @property
    def in_keys(self) -> list[NestedKey]:
        """Entries that :meth:`forward` and the terms read."""
        further = [unravel_key(key) for term in self.terms.values() for key in term.in_keys]
        return list(dict.fromkeys([*super().in_keys, *further]))


def _add(loss: Tensor, penalties: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
    """A loss of every sample with all penalties of its shape, and these as they are reported.

    Raises:
        ValueError: for a penalty of another shape.
    """
    for name, penalty in penalties.items():
        if penalty.shape != loss.shape:
            raise ValueError(f"{name} must have the shape {tuple(loss.shape)}, got {tuple(penalty.shape)}.")
        loss = loss + penalty
    return loss, {name: penalty.detach() for name, penalty in penalties.items()}
