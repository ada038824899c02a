"""Keeps the interpolator of a loss current, in any environment and with any of TorchRL's trainers."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.trainers.trainers import Trainer

from morlnav.envs import eval_mode
from morlnav.trainers.hooks import PeriodicHook


class FitInterpolator(PeriodicHook):
    """Measure the value of every key preference by roll-outs, and refit the interpolator of the trainer's loss to them.

    Each key is measured by one episode per environment of the batch, driven without exploration noise; its value is
    the mean discounted return vector, with the loss's discount. The expected utility over the keys is logged.

    Args:
        env: an environment of its own that keeps a preference handed to ``reset``, as one with
            :class:`~morlnav.transforms.DrawPreference` does.
        frames: environment steps of the training between two measurements.
        max_steps: steps after which a measured episode is cut off.

    Raises:
        ValueError: at registration, if the trainer's loss has no interpolator.

    Examples:
        >>> hook = FitInterpolator(env, frames=10_000, max_steps=250)  # doctest: +SKIP
        >>> hook.register(trainer)  # doctest: +SKIP
    """

    def __init__(self, env: EnvBase, frames: int, max_steps: int) -> None:
        super().__init__(frames)
        self.env, self.max_steps = env, max_steps

    def __call__(self) -> None:
        """Measure and refit if it is due."""
        if not self.due():
            return
        loss = self.trainer.loss_module
        keys = loss.interpolator.preferences
        values = torch.stack([self._value(key) for key in keys])
        loss.interpolator.update(keys, values)
        utility = (loss.scalarisation(keys, values.shape[-1]) * values).sum(-1).mean()
        self.trainer._log(expected_utility=utility.item())

    @torch.no_grad()
    def _value(self, preference: Tensor) -> Tensor:
        """Mean discounted return vector ``[m]`` under one preference ``[n]``."""
        loss, env = self.trainer.loss_module, self.env
        given = TensorDict(batch_size=env.batch_size, device=env.device)
        given[loss.tensor_keys.preference] = preference.to(env.device).expand(*env.batch_size, -1)
        with (
            set_exploration_type(ExplorationType.DETERMINISTIC),
            eval_mode(loss.actor_network),
            loss.actor_network_params.to_module(loss.actor_network, preserve_module_state=False),
        ):
            rollout = env.rollout(
                self.max_steps,
                loss.actor_network,
                auto_reset=False,
                tensordict=env.reset(given),
                break_when_all_done=True,
            )
        following = rollout["next"].reshape(-1, rollout.shape[-1])  # [episodes, steps]
        done = following[loss.tensor_keys.done]
        running = done.cumsum(1) - done.long() == 0  # the step that ends an episode is part of it
        discounts = loss.value_estimator.gamma.to(env.device) ** torch.arange(done.shape[1], device=env.device)[:, None]
        return (following[loss.tensor_keys.reward] * running * discounts).sum(1).mean(0).to(preference.device)

    def register(self, trainer: Trainer, name: str = "fit_interpolator") -> None:
        """Register after every round of optimisation steps."""
        if getattr(trainer.loss_module, "interpolator", None) is None:
            raise ValueError("FitInterpolator needs a loss with an interpolator; give the loss one.")
        self.trainer = trainer
        trainer.register_op("post_steps", self)
        trainer.register_module(name, self)
