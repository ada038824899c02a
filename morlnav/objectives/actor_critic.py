"""What every loss with one actor and several vector-valued critics needs of TorchRL, and no word of an algorithm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tensordict import TensorDict, TensorDictBase, TensorDictParams, unravel_key
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import TensorSpec
from torchrl.objectives.common import LossModule
from torchrl.objectives.utils import ValueEstimators, _vmap_func
from torchrl.objectives.value import TD0Estimator

from morlnav.objectives.bounds import action_bounds


class VectorActorCriticLoss(LossModule):
    """Base of losses whose critics have one value per objective: keys, parameters and targets, values, bootstrapping.

    Subclasses write ``actor_loss``, ``value_loss`` and ``forward``.

    Args:
        actor_network: writes ``action`` from ``observation`` and ``preference``.
        qvalue_network: writes ``state_action_value`` ``[..., m]``; one module that is copied, or a list.
        num_qvalue_nets: number of critics.
        action_spec: bounded spec of the action; or give ``bounds``.
        bounds: ``(low, high)`` of the action; exactly one of the two.

    Attributes:
        reduction: ``"mean"``, ``"sum"`` or ``"none"`` over the batch.
        use_prioritized_weights: weigh samples by the buffer's importance weights, ``"auto"`` where present.
        deactivate_vmap: loop over critics instead of ``vmap``.

    Raises:
        ValueError: for missing, contradictory or infinite action bounds, or a list of other than ``num_qvalue_nets``
            different critics.
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
    SUPPORTED_VALUE_ESTIMATORS = (ValueEstimators.TD0,)
    reduction = "mean"
    use_prioritized_weights: str | bool = "auto"
    deactivate_vmap = False

    actor_network: TensorDictModule
    qvalue_network: TensorDictModule
    actor_network_params: TensorDictParams
    qvalue_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams
    target_qvalue_network_params: TensorDictParams
    min_action: Tensor
    max_action: Tensor

    def __init__(
        self,
        actor_network: TensorDictModule,
        qvalue_network: TensorDictModule | Sequence[TensorDictModule] | nn.ModuleList,
        num_qvalue_nets: int,
        action_spec: TensorSpec | None,
        bounds: tuple[Tensor | float, Tensor | float] | None,
    ) -> None:
        super().__init__()
        self.num_qvalue_nets = num_qvalue_nets
        self.convert_to_functional(actor_network, "actor_network", create_target_params=True)
        self._convert_critics(qvalue_network)
        low, high = action_bounds(action_spec, bounds, self.tensor_keys.action)
        device = next(self.parameters()).device
        self.register_buffer("min_action", low.to(device))
        self.register_buffer("max_action", high.to(device))
        self._make_vmap()

    def _convert_critics(self, network: TensorDictModule | Sequence[TensorDictModule] | nn.ModuleList) -> None:
        number = self.num_qvalue_nets
        critics = [network] if isinstance(network, TensorDictModuleBase) else list(network)
        if len(critics) > 1 and not len({id(critic) for critic in critics}) == len(critics) == number:
            raise ValueError(
                f"qvalue_network must list num_qvalue_nets={number} different critics, or be a single one."
            )
        weights = TensorDict.from_module(critics[0]).data.clone()
        network = critics if len(critics) > 1 else critics[0]
        self.convert_to_functional(network, "qvalue_network", number, create_target_params=True)
        if number == 1:  # there is nothing to draw anew
            for params in (self.qvalue_network_params, self.target_qvalue_network_params):
                params.data.update_(weights.unsqueeze(0))

    def _make_vmap(self) -> None:
        module = getattr(self.qvalue_network, "module", None)
        self._stackable = getattr(module, "stackable", False) and not self.deactivate_vmap
        self._vmap_qvalue_network00 = _vmap_func(
            self.qvalue_network, (None, 0), randomness=self.vmap_randomness, pseudo_vmap=self.deactivate_vmap
        )

    @property
    def in_keys(self) -> list[NestedKey]:
        """Entries that :meth:`forward` reads."""
        keys, actor, critic = self.tensor_keys, self.actor_network.in_keys, self.qvalue_network.in_keys
        read = [
            keys.action,
            keys.preference,
            *(("next", key) for key in (keys.reward, keys.done, keys.terminated)),
            *actor,
            *(("next", key) for key in actor),
            *critic,
            *(("next", key) for key in critic if key != keys.action),
        ]
        return list(dict.fromkeys(map(unravel_key, read)))

    def act(self, tensordict: TensorDictBase, params: TensorDictParams) -> TensorDictBase:
        """What the critics read, with the action of an actor with these parameters in it."""
        inputs = tensordict.select(*self.actor_network.in_keys, *self.qvalue_network.in_keys, strict=False)
        with params.to_module(self.actor_network, preserve_module_state=False):
            return self.actor_network(inputs)

    def values(self, tensordict: TensorDictBase, params: TensorDictParams) -> Tensor:
        """Value vectors ``[k, B, m]`` of the critics with these ``k`` parameters, in one batched product."""
        inputs = tensordict.select(*self.qvalue_network.in_keys, strict=False)
        if not self._stackable:
            return self._vmap_qvalue_network00(inputs, params).get(self.tensor_keys.state_action_value)
        inputs = inputs.flatten()
        inputs.batch_size = []  # the values get a dimension of critics in front
        with params.to_module(self.qvalue_network, preserve_module_state=False):
            values = self.qvalue_network(inputs).get(self.tensor_keys.state_action_value)
        return values.reshape(len(values), *tensordict.batch_size, values.shape[-1])

    def bootstrap(self, tensordict: TensorDictBase, next_value: Tensor) -> Tensor:
        """``r + γⁿ·(1 - terminated)·V`` ``[B, m]`` for values ``[B, m]`` of what lies ``n`` steps ahead.

        ``n`` is 1, unless a transform of the replay buffer such as ``MultiStepTransform`` wrote ``steps_to_next_obs``.
        """
        keys, steps = self.tensor_keys, self.value_estimator.tensor_keys.steps_to_next_obs
        inputs = tensordict.select("next", steps, strict=False).copy()
        inputs.set(("next", keys.state_action_value), next_value)
        for key in (("next", keys.done), ("next", keys.terminated), steps):
            entry = inputs.get(key, None)
            if entry is not None:  # the stock estimator wants the reward's shape
                inputs.set(key, entry.reshape(*next_value.shape[:-1], -1).expand_as(next_value))
        return self.value_estimator.value_estimate(inputs)

    def make_value_estimator(self, value_type: ValueEstimators | None = None, **hyperparams: Any) -> LossModule:
        """Choose the value estimator, with ``gamma`` one number or one per entry of the reward ``[m]``.

        Raises:
            NotImplementedError: for any estimator but TD0, the only one that is defined for vector rewards.
        """
        value_type, hyperparams = self._prepare_value_estimator_kwargs(value_type, **hyperparams)
        if value_type is not None:
            if value_type not in self.SUPPORTED_VALUE_ESTIMATORS:
                raise NotImplementedError(f"{type(self).__name__} supports TD0 targets, not {value_type}.")
            self._value_estimator = TD0Estimator(value_network=None, **hyperparams)
        self._forward_value_estimator_keys()
        return self

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        if self._value_estimator is not None:
            self._value_estimator.set_keys(value=self.tensor_keys.state_action_value)
        super()._forward_value_estimator_keys(**kwargs)
