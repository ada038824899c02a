"""Keeps what a loss's terms know of the policy's returns current, in any environment."""

from __future__ import annotations

import torch

from morlnav.evaluation import Evaluation, utility
from morlnav.limits import check_at_least
from morlnav.trainers.hooks import PeriodicHook, log_scalar


class FitInterpolator(PeriodicHook):
    """Measure the value of every key preference by roll-outs of the averaged actor, and refit interpolators to them.

    It serves every term of the trainer's loss that has an ``interpolator``, such as the angle. A key's value is the
    mean discounted return vector of some episodes, the same for every key, with the loss's present discount.

    Args:
        interval: environment steps of the training between two measurements.
        episodes: per key.
        evaluation: drives them.
        policy: the actor that is measured.

    Raises:
        ValueError: for numbers below 1.
    """

    name = "fit_interpolator"

    def __init__(
        self, interval: int = 40_000, episodes: int = 12, *, evaluation: Evaluation, policy: torch.nn.Module
    ) -> None:
        super().__init__(interval)
        check_at_least(1, episodes=episodes)
        self.episodes, self.evaluation, self.policy = episodes, evaluation, policy

    def __call__(self) -> None:
        """Measure and refit if it is due."""
        loss = self.trainer.loss_module
        terms = [term for term in loss.terms.values() if hasattr(getattr(term, "interpolator", None), "preferences")]
        if not terms or not self.due():
            return
        gamma = loss.value_estimator.gamma
        for term in terms:
            keys = term.interpolator.preferences
            values = self.evaluation.returns(self.policy, keys, self.episodes, self.evaluation.seed + 1, gamma)
            values = values.mean(1).to(keys)
            term.update(keys, values)
            expected = utility(values, keys, loss.scalarisation).mean().item()
            log_scalar(self.trainer, "optim/key_utility", expected, self.last)
