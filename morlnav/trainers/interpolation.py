"""Keeps what a loss's terms know of the policy's returns current, in any environment."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import EnvBase
from torchrl.trainers.trainers import Trainer

from morlnav.evaluation import discounted_returns, utility
from morlnav.trainers.hooks import PeriodicHook, log_scalar


class FitInterpolator(PeriodicHook):
    """Measure the value of every key preference by roll-outs of the averaged actor, and refit interpolators to them.

    It serves every term of the trainer's loss that has an ``interpolator``, such as the angle. A key's value is the mean
    discounted return vector of some episodes, the same for every key, with the loss's present discount.

    Args:
        interval: environment steps of the training between two measurements.
        episodes: per key.
        make_env: ``make_env(num_envs=...)`` makes an environment that keeps a preference handed to ``reset``.
        policy: the actor that is measured.
        max_steps: time limit of an episode.
        seed: of the training; the episodes are drawn from one of their own.

    Raises:
        ValueError: for numbers below 1.
    """

    def __init__(
        self,
        interval: int = 40_000,
        episodes: int = 12,
        *,
        make_env: Callable[..., EnvBase],
        policy: torch.nn.Module,
        max_steps: int = 1000,
        seed: int = 0,
    ) -> None:
        super().__init__(interval)
        if episodes < 1:
            raise ValueError(f"episodes must be at least 1, got {episodes}.")
        self.episodes, self.make_env, self.max_steps, self.seed = episodes, make_env, max_steps, seed
        self.policy = TensorDictModule(policy, ["observation", "preference"], ["action"])
        self.env: EnvBase | None = None

    def __call__(self) -> None:
        """Measure and refit if it is due."""
        terms = [term for term in self.trainer.loss_module.terms.values() if getattr(term, "interpolator", None)]
        if not terms or not self.due():
            return
        if self.env is None:
            self.env = self.make_env(num_envs=self.episodes).eval()
        loss = self.trainer.loss_module
        gamma = loss.value_estimator.gamma
        for term in terms:
            keys = term.interpolator.preferences
            values = discounted_returns(self.env, self.policy, keys, self.max_steps, gamma, seed=self.seed).mean(1)
            term.update(keys, values.to(keys))
            expected = utility(values.to(keys), keys, loss.scalarisation).mean().item()
            log_scalar(self.trainer, "optim/key_utility", expected, self.last)

    def register(self, trainer: Trainer, name: str = "fit_interpolator") -> None:
        """Register after every round of optimisation steps."""
        self.trainer = trainer
        trainer.register_op("post_steps", self)
        trainer.register_module(name, self)
