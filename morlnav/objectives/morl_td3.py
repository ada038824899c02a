"""MORL-TD3: twin delayed deterministic policy gradients with vector-valued, preference-conditioned critics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase, TensorDictParams, unravel_key
from tensordict.nn import TensorDictModule, TensorDictModuleBase, dispatch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import TensorSpec
from torchrl.envs.utils import step_mdp
from torchrl.objectives.common import LossModule
from torchrl.objectives.utils import ValueEstimators, _vmap_func, distance_loss
from torchrl.objectives.value import TD0Estimator

from morlnav.objectives.angle import AngleTerm
from morlnav.objectives.bounds import ReturnBounds, action_bounds
from morlnav.objectives.guidance import Guidance
from morlnav.objectives.scalarisation import LinearScalarisation

LOSS_FUNCTIONS = ("l2", "l1", "smooth_l1")


class MORLTD3Loss(LossModule):
    """Losses of MORL-TD3 (Sec. III-B) for any number of objectives.

    With weights ``w(λ) = [1, …, λ]``, interpolated direction ``λ_p`` and the angle ``g`` of Eq. 1::

        y        = r + γ·[β·Q_k + (1 - β)·mean_i Q_i](s', ã, λ),   k = argmin_i wᵀQ_i   (the whole vector of one twin)
        L_critic = Σ_i ℓ(Q_i(s, a, λ), y) + c_critic·g(λ_p, Q_i)
        L_actor  = -wᵀQ_1(s, π(s, λ), λ) + c_actor·g(λ_p, Q_1)

    It is a drop-in for :class:`torchrl.objectives.TD3Loss`: same arguments, keys, metadata and target parameters.

    Args:
        actor_network: writes ``action`` from ``observation`` and ``preference``.
        qvalue_network: writes ``state_action_value`` ``[..., m]``. One module is copied ``num_qvalue_nets`` times with
            weights drawn uniformly from its range, which suits uniformly initialised weights alone; a list or
            ``ModuleList`` of modules keeps their own, as does a critic that is the only one. Where the wrapped module
            has a true ``stackable``, it is called once with all parameters stacked, instead of ``vmap``.
        action_spec: bounded spec of the action; or give ``bounds``.
        bounds: ``(low, high)`` of the action; exactly one of the two.
        num_qvalue_nets: number of critics.
        actor_qvalue_nets: of how many the actor climbs the mean: 1 as in TD3; with more it follows fewer errors.
        policy_noise: standard deviation of the target's smoothing noise, in units of half the action range.
        noise_clip: the noise is clipped to this, in the same units.
        loss_function: ``"l2"``, ``"l1"`` or ``"smooth_l1"``.
        pessimism: ``β``: 1 takes the smaller twin (Sec. III-B), 0 the mean of all, which is less careful.
        delay_actor: keep a target actor.
        delay_qvalue: keep target critics.
        scalarisation: maps ``(λ, m)`` to weights; :class:`LinearScalarisation` by default.
        angle: the angle term; ``None`` leaves it out.
        interpolator: maps λ to a value direction ``λ_p`` ``[..., m]``; without one, ``λ_p`` is the weight vector.
        reward_bounds: least and largest reward of a step, each ``[m]`` or one number, infinite where unknown. Targets
            then stay within what any policy can return (:class:`ReturnBounds`), so that no actor can feed on a critic's
            overestimate.
        guidance: adds a pull toward a demonstrator's actions to the actor's loss, or pulls toward those of several;
            ``None`` leaves it out.
        separate_losses: keep critic gradients off parameters shared with the actor.
        reduction: ``"mean"``, ``"sum"`` or ``"none"`` over the batch.
        deactivate_vmap: loop over critics instead of ``vmap``.
        use_prioritized_weights: weigh samples by the buffer's importance weights, ``"auto"`` where present.

    Raises:
        ValueError: for missing or contradictory action bounds, an unknown ``loss_function``, ``pessimism`` outside
            [0, 1], more critics for the actor than there are, a list of other than ``num_qvalue_nets`` different
            critics or, with ``separate_losses``, of such as share parameters with the actor, or a least reward above
            the largest.

    Examples:
        >>> from morlnav.modules import Actor, VectorCritic
        >>> low, high = torch.tensor([0.0, -3.14]), torch.tensor([0.5, 3.14])
        >>> actor = TensorDictModule(Actor(2, low, high), ["observation", "preference"], ["action"])
        >>> critic = TensorDictModule(
        ...     VectorCritic(3, 2, low, high), ["observation", "preference", "action"], ["state_action_value"]
        ... )
        >>> loss = MORLTD3Loss(actor, critic, bounds=(low, high))
        >>> batch = TensorDict(
        ...     observation=torch.randn(8, 34), preference=torch.full((8, 2), 0.5), action=torch.rand(8, 2),
        ...     next=dict(observation=torch.randn(8, 34), preference=torch.full((8, 2), 0.5), reward=torch.randn(8, 3),
        ...               done=torch.zeros(8, 1, dtype=torch.bool), terminated=torch.zeros(8, 1, dtype=torch.bool)),
        ...     batch_size=[8],
        ... )
        >>> sorted(loss(batch).keys())[:2]
        ['loss_actor', 'loss_qvalue']
    """

    @dataclass
    class _AcceptedKeys:
        """Configurable keys; ``preference`` is where λ is read, the rest as in TorchRL's ``TD3Loss``."""

        action: NestedKey = "action"
        preference: NestedKey = "preference"
        state_action_value: NestedKey = "state_action_value"
        priority: NestedKey = "td_error"
        reward: NestedKey = "reward"
        done: NestedKey = "done"
        terminated: NestedKey = "terminated"
        priority_weight: NestedKey = "priority_weight"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys
    default_value_estimator = ValueEstimators.TD0
    out_keys = [  # noqa: RUF012  (the class attribute TorchRL defines)
        "loss_actor",
        "loss_qvalue",
        "pred_value",
        "state_action_value_actor",
        "next_state_value",
        "target_value",
        "angle_actor",
        "angle_qvalue",
        "guidance",
    ]

    actor_network: TensorDictModule
    qvalue_network: TensorDictModule
    actor_network_params: TensorDictParams
    qvalue_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams
    target_qvalue_network_params: TensorDictParams

    def __init__(
        self,
        actor_network: TensorDictModule,
        qvalue_network: TensorDictModule | list[TensorDictModule] | nn.ModuleList,
        *,
        action_spec: TensorSpec | None = None,
        bounds: tuple[Tensor | float, Tensor | float] | None = None,
        num_qvalue_nets: int = 2,
        actor_qvalue_nets: int = 1,
        policy_noise: float = 0.2,
        noise_clip: float = 0.5,
        loss_function: str = "smooth_l1",
        pessimism: float = 1.0,
        delay_actor: bool = True,
        delay_qvalue: bool = True,
        scalarisation: nn.Module | None = None,
        angle: AngleTerm | None = None,
        interpolator: nn.Module | None = None,
        reward_bounds: tuple[Tensor | Sequence[float] | float, Tensor | Sequence[float] | float] | None = None,
        guidance: Guidance | Sequence[Guidance] | None = None,
        separate_losses: bool = False,
        reduction: str | None = None,
        deactivate_vmap: bool = False,
        use_prioritized_weights: str | bool = "auto",
    ) -> None:
        super().__init__()
        if loss_function not in LOSS_FUNCTIONS:
            raise ValueError(f"loss_function must be one of {', '.join(LOSS_FUNCTIONS)}, got {loss_function}.")
        if not 0 <= pessimism <= 1:
            raise ValueError(f"pessimism must be between 0 and 1, got {pessimism}.")
        if not 1 <= actor_qvalue_nets <= num_qvalue_nets:
            raise ValueError(f"actor_qvalue_nets must be between 1 and {num_qvalue_nets}, got {actor_qvalue_nets}.")
        self.pessimism = pessimism
        self.use_prioritized_weights = use_prioritized_weights
        self._in_keys = None
        self.delay_actor = delay_actor
        self.delay_qvalue = delay_qvalue
        self.deactivate_vmap = deactivate_vmap
        self.num_qvalue_nets = num_qvalue_nets
        self.actor_qvalue_nets = actor_qvalue_nets
        self.policy_noise = policy_noise
        self.noise_clip = noise_clip
        self.loss_function = loss_function
        self.reduction = reduction or "mean"
        self.scalarisation = scalarisation if scalarisation is not None else LinearScalarisation()
        self.angle = angle
        self._angled_critics = angle is not None and angle.critic > 0
        self.interpolator = interpolator
        self.guidance = nn.ModuleList([guidance] if isinstance(guidance, Guidance) else guidance or [])
        absent = {"angle_actor": angle is None, "angle_qvalue": not self._angled_critics, "guidance": not self.guidance}
        self.out_keys = [key for key in self.out_keys if not absent.get(key)]

        policy_params = list(actor_network.parameters()) if separate_losses else None
        self.convert_to_functional(actor_network, "actor_network", create_target_params=delay_actor)
        critics = [qvalue_network] if isinstance(qvalue_network, TensorDictModuleBase) else list(qvalue_network)
        if len(critics) > 1:
            _check_critics(critics, num_qvalue_nets, policy_params or [])
        weights = TensorDict.from_module(critics[0]).data.clone()
        self.convert_to_functional(
            critics if len(critics) > 1 else critics[0],
            "qvalue_network",
            num_qvalue_nets,
            create_target_params=delay_qvalue,
            compare_against=policy_params,
        )
        if num_qvalue_nets == 1:  # there is nothing to draw anew
            for params in (self.qvalue_network_params, self.target_qvalue_network_params):
                params.data.update_(weights.unsqueeze(0))
        low, high = action_bounds(action_spec, bounds, self.tensor_keys.action)
        device = next(self.parameters()).device
        self.register_buffer("min_action", low.to(device))
        self.register_buffer("max_action", high.to(device))
        self.return_bounds = None if reward_bounds is None else ReturnBounds(*reward_bounds).to(device)
        self._make_vmap()

    def _make_vmap(self) -> None:
        module = getattr(self.qvalue_network, "module", None)
        self._stackable = getattr(module, "stackable", False) and not self.deactivate_vmap
        self._vmap_qvalue_network00 = _vmap_func(
            self.qvalue_network, (None, 0), randomness=self.vmap_randomness, pseudo_vmap=self.deactivate_vmap
        )

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        if self._value_estimator is not None:
            self._value_estimator.set_keys(
                value=self.tensor_keys.state_action_value,
                reward=self.tensor_keys.reward,
                done=self.tensor_keys.done,
                terminated=self.tensor_keys.terminated,
            )
        self._set_in_keys()

    def _set_in_keys(self) -> None:
        keys = self.tensor_keys
        self._in_keys = list(
            dict.fromkeys(
                unravel_key(key)
                for key in [
                    keys.action,
                    keys.preference,
                    ("next", keys.reward),
                    ("next", keys.done),
                    ("next", keys.terminated),
                    *self.actor_network.in_keys,
                    *(key for guidance in self.guidance for key in guidance.guide.in_keys),
                    *[("next", key) for key in self.actor_network.in_keys],
                    *self.qvalue_network.in_keys,
                    *[("next", key) for key in self.qvalue_network.in_keys if key != keys.action],
                ]
            )
        )

    @property
    def in_keys(self) -> list[NestedKey]:
        """Entries that :meth:`forward` reads."""
        if self._in_keys is None:
            self._set_in_keys()
        return self._in_keys

    @in_keys.setter
    def in_keys(self, values: list[NestedKey]) -> None:
        self._in_keys = values

    def _values(self, tensordict: TensorDictBase, params: TensorDictParams) -> Tensor:
        """Value vectors ``[k, B, m]`` of the critics with these ``k`` parameters, in one batched product."""
        inputs = tensordict.select(*self.qvalue_network.in_keys, strict=False)
        if not self._stackable:
            return self._vmap_qvalue_network00(inputs, params).get(self.tensor_keys.state_action_value)
        inputs = inputs.flatten()
        inputs.batch_size = []  # the values get a dimension of critics in front
        with params.to_module(self.qvalue_network, preserve_module_state=False):
            values = self.qvalue_network(inputs).get(self.tensor_keys.state_action_value)
        return values.reshape(len(values), *tensordict.batch_size, values.shape[-1])

    def _act(self, tensordict: TensorDictBase, params: TensorDictParams) -> TensorDictBase:
        inputs = tensordict.select(*self.actor_network.in_keys, *self.qvalue_network.in_keys, strict=False)
        with params.to_module(self.actor_network, preserve_module_state=False):
            return self.actor_network(inputs)

    def _scalarise(self, tensordict: TensorDictBase, value: Tensor) -> Tensor:
        """``wᵀQ`` of value vectors ``[..., B, m]``, ``[..., B]``."""
        weights = self.scalarisation(tensordict.get(self.tensor_keys.preference), value.shape[-1])
        return (weights * value).sum(-1)

    @property
    def _half_range(self) -> Tensor:
        return (self.max_action - self.min_action) / 2

    def _angles(self, tensordict: TensorDictBase, value: Tensor) -> Tensor:
        """Angles between value vectors ``[..., B, m]`` and the preference's interpolated direction, ``[..., B]``."""
        preference = tensordict.get(self.tensor_keys.preference)
        if self.interpolator is None:
            direction = self.scalarisation(preference, value.shape[-1])
        else:
            direction = self.interpolator(preference)
        return self.angle(direction.detach().expand_as(value), value)

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of the actor and its metadata; the critics that it climbs get no gradient."""
        weights = self._maybe_get_priority_weight(tensordict)
        acted = self._act(tensordict, self.actor_network_params)
        values = self._actors_values(acted)
        value = values.mean(0)
        loss = -self._scalarise(tensordict, value)
        metadata = {"state_action_value_actor": value.detach()}
        if self.guidance:
            penalty = self._guide(tensordict, acted, values.detach())
            metadata["guidance"] = penalty.detach()
            loss = loss + penalty
        if self.angle is not None:
            angle = self._angles(tensordict, value)
            metadata["angle_actor"] = angle.detach()
            loss = loss + self.angle.actor * angle
        return self._reduce_loss(loss, tensordict=tensordict, weights=weights), metadata

    def _actors_values(self, acted: TensorDictBase) -> Tensor:
        """Value vectors ``[k, B, m]`` of the critics whose mean the actor climbs."""
        return self._values(acted, self.qvalue_network_params.detach()[: self.actor_qvalue_nets])

    def _guide(self, tensordict: TensorDictBase, acted: TensorDictBase, values: Tensor) -> Tensor:
        """Penalty ``[B]`` of all guidances, given the values ``[k, B, m]`` of the actor's actions."""
        action, preference = acted.get(self.tensor_keys.action), tensordict.get(self.tensor_keys.preference)
        proposed = [self._propose(guidance, tensordict, acted, values) for guidance in self.guidance]
        searched = [gain for guidance, (_, gain) in zip(self.guidance, proposed, strict=True) if guidance.entry is None]
        known = torch.stack([torch.zeros_like(preference[..., 0]), *searched]).amax(0)
        return sum(
            guidance(
                (action - proposal) / self._half_range, gain if guidance.entry is None else gain - known, preference
            )
            for guidance, (proposal, gain) in zip(self.guidance, proposed, strict=True)
        )

    @torch.no_grad()
    def _propose(
        self, guidance: Guidance, tensordict: TensorDictBase, acted: TensorDictBase, values: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The best of a guide's proposals ``[B, A]``, and the scalarised gain ``[B]`` that the critics see in it."""
        guide, batch = guidance.guide, (guidance.proposals, *tensordict.batch_size)
        proposals = guide(tensordict.select(*guide.in_keys).expand(batch)).get(guide.out_keys[0])
        gain = self._actors_values(acted.expand(batch).set(self.tensor_keys.action, proposals)) - values.unsqueeze(1)
        if guidance.entry is None:
            gain = self._scalarise(tensordict, gain.mean(0))
        else:  # what was demonstrated needs no judgement, but both critics have to agree about the rest
            static = gain.shape[-1] - tensordict.get(self.tensor_keys.preference).shape[-1]
            gain[..., static + guidance.entry] = 0
            gain = self._scalarise(tensordict, gain).amin(0)
        gain, best = gain.max(0)
        return proposals.take_along_dim(best[None, ..., None], 0).squeeze(0), gain

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of the critics and its metadata; ``td_error`` is ``[num_qvalue_nets, B]``, summed over objectives."""
        weights = self._maybe_get_priority_weight(tensordict)
        target, next_value = self._target(tensordict)
        value = self._values(tensordict, self.qvalue_network_params)
        loss = distance_loss(value, target.expand_as(value), loss_function=self.loss_function).sum(-1)
        metadata = {
            "td_error": (value - target).detach().pow(2).sum(-1),
            "next_state_value": next_value,
            "pred_value": value.detach(),
            "target_value": target,
        }
        if self._angled_critics:
            angle = self._angles(tensordict, value)
            metadata["angle_qvalue"] = angle.detach()
            loss = loss + self.angle.critic * angle
        return self._reduce_loss(loss.sum(0), tensordict=tensordict, weights=weights), metadata

    @torch.no_grad()
    def _target(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Target vectors ``y`` and bootstrapped values, both ``[B, m]``."""
        keys = self.tensor_keys
        following = step_mdp(tensordict)
        following = self._act(following, self.target_actor_network_params)
        action = following.get(keys.action)
        noise = (torch.randn_like(action) * self.policy_noise).clamp(-self.noise_clip, self.noise_clip)
        following.set(keys.action, (action + noise * self._half_range).clamp(self.min_action, self.max_action))
        twins = self._values(following, self.target_qvalue_network_params)
        chosen = self._scalarise(following, twins).argmin(0)[None, ..., None].expand(1, *twins.shape[1:])
        next_value = twins.mean(0).lerp(twins.gather(0, chosen).squeeze(0), self.pessimism)

        inputs = tensordict.select("next").copy()
        inputs.set(("next", keys.state_action_value), next_value)
        for key in (keys.done, keys.terminated):  # the stock estimator wants flags in the reward's shape
            flag = inputs.get(("next", key))
            inputs.set(("next", key), flag.expand_as(next_value))
        value = self.value_estimator.value_estimate(inputs)
        return value if self.return_bounds is None else self.return_bounds(
            value, self.value_estimator.gamma
        ), next_value

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Both losses and their metadata; writes the priority of every sample into ``tensordict``."""
        loss_actor, actor_metadata = self.actor_loss(tensordict)
        loss_qvalue, value_metadata = self.value_loss(tensordict)
        tensordict.set(self.tensor_keys.priority, value_metadata.pop("td_error").max(0)[0])
        return TensorDict(loss_actor=loss_actor, loss_qvalue=loss_qvalue, **actor_metadata, **value_metadata)

    SUPPORTED_VALUE_ESTIMATORS = (ValueEstimators.TD0,)

    def make_value_estimator(self, value_type: ValueEstimators | None = None, **hyperparams: Any) -> MORLTD3Loss:
        """Choose the value estimator; only one-step TD is defined for vector rewards.

        Raises:
            NotImplementedError: for any estimator but TD0.
        """
        value_type, hyperparams = self._prepare_value_estimator_kwargs(value_type, **hyperparams)
        if value_type is None:
            self._forward_value_estimator_keys()
            return self
        if value_type not in self.SUPPORTED_VALUE_ESTIMATORS:
            raise NotImplementedError(f"MORLTD3Loss supports TD0 targets, not {value_type}.")
        self._value_estimator = TD0Estimator(value_network=None, **hyperparams)
        self._forward_value_estimator_keys()
        return self


def _check_critics(critics: Sequence[nn.Module], number: int, actors: Sequence[nn.Parameter]) -> None:
    if not len({id(critic) for critic in critics}) == len(critics) == number:
        raise ValueError(f"qvalue_network must list num_qvalue_nets={number} different critics, or be a single one.")
    known = {id(parameter) for parameter in actors}
    if any(id(parameter) in known for critic in critics for parameter in critic.parameters()):
        raise ValueError("separate_losses needs a single critic that is copied: listed ones stay tied to the actor.")
