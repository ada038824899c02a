"""Behaviour cloning: regression of a policy's actions on demonstrated ones."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, dispatch
from torch import Tensor
from torchrl.data import Bounded
from torchrl.objectives import BCLoss
from torchrl.objectives.utils import distance_loss

from morlnav.objectives.bounds import action_bounds

LOSS_FUNCTIONS = ("l2", "smooth_l1")


class BehaviourCloningLoss(BCLoss):
    """TorchRL's ``BCLoss`` with errors in normalised actions, so that m/s and rad/s count alike (Sec. III-C).

    With the half range ``h = (high - low) / 2`` of each action entry::

        L = mean ℓ((π(s) - a) / h)

    Keys are those of ``BCLoss``: ``action`` holds the label, and is where the actor writes its own; ``pad_mask``
    (default: none) marks padded steps.

    Args:
        actor_network: writes ``action`` ``[..., A]`` from whatever it reads, such as ``observation``.
        action_spec: bounded spec of the action ``[..., A]``; or give ``bounds``.
        bounds: ``(low, high)`` of the action, each ``[A]``; exactly one of the two.
        loss_function: ``"l2"`` or ``"smooth_l1"``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"`` over batch and action entries.

    Raises:
        ValueError: for missing, contradictory or empty bounds, or an unknown ``loss_function``.

    Examples:
        >>> from morlnav.modules import Actor
        >>> low, high = torch.tensor([0.0, -3.14]), torch.tensor([0.5, 3.14])
        >>> clone = TensorDictModule(Actor(0, low, high, features=34), ["observation"], ["action"])
        >>> loss = BehaviourCloningLoss(clone, bounds=(low, high))
        >>> out = loss(TensorDict(observation=torch.zeros(8, 34), action=torch.zeros(8, 2), batch_size=[8]))
        >>> out["loss_bc"].shape, out["error"].shape
        (torch.Size([]), torch.Size([2]))
    """

    out_keys = ["loss_bc", "error"]  # noqa: RUF012  (the class attribute TorchRL defines)

    target_actor_network_params: TensorDictParams

    def __init__(
        self,
        actor_network: TensorDictModule,
        *,
        action_spec: Bounded | None = None,
        bounds: tuple[Tensor, Tensor] | None = None,
        loss_function: str = "l2",
        reduction: str | None = None,
    ) -> None:
        if loss_function not in LOSS_FUNCTIONS:
            raise ValueError(f"loss_function must be one of {', '.join(LOSS_FUNCTIONS)}, got {loss_function}.")
        super().__init__(actor_network, loss_function=loss_function, reduction=reduction)
        low, high = action_bounds(action_spec, bounds, self.tensor_keys.action)
        self.register_buffer("half_range", ((high - low) / 2).to(next(self.parameters()).device))

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """``loss_bc``, and ``error`` ``[A]``: the mean absolute error per action entry, in half action ranges."""
        mask = self._mask(tensordict)
        inputs = tensordict.select(*self.actor_network.in_keys)
        label = tensordict.get(self.tensor_keys.action)
        if mask is not None:
            steps = mask.reshape(label.shape[:-1])
            label = label.masked_fill(~steps.unsqueeze(-1), 0)
            if tensordict.shape[: steps.ndim] == steps.shape:  # or one observation serves a chunk of actions
                inputs = inputs.masked_fill(~steps, 0)
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            action = self.actor_network(inputs).get(self.tensor_keys.action)
        error = (action - label) / self.half_range
        loss = distance_loss(error, torch.zeros_like(error), self.loss_function)
        entries = [
            self._reduce_loss(entry, tensordict, mask=mask, reduction="mean")
            for entry in error.detach().abs().unbind(-1)
        ]
        return TensorDict(loss_bc=self._reduce_loss(loss, tensordict, mask=mask), error=torch.stack(entries))

    def _mask(self, tensordict: TensorDictBase) -> Tensor | None:
        key = self.tensor_keys.pad_mask
        padded = None if key is None else tensordict.get(key, None)
        return None if padded is None else ~padded
