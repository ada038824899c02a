"""Keeps what a loss's terms know of the policy's returns current, in any environment."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torchrl.trainers.trainers import Trainer

from morlnav import deployment
from morlnav.evaluation import Evaluation, utility
from morlnav.limits import check_at_least
from morlnav.objectives.terms.base import LossTerm
from morlnav.trainers.hooks import PeriodicHook, log_scalar


class FitInterpolator(PeriodicHook):
    """Measure the value of every key preference by roll-outs of the averaged actor, and refit interpolators to them.

    It serves every term of the trainer's loss that has an ``interpolator``, such as the angle. A key's value is the
    mean discounted return vector of some episodes, the same for every key, with the loss's present discount.

    PD-MORL takes its first key values from agents that were trained before, so that values are not drawn toward
    directions that nothing has reached yet: ``keys`` names the run of such an agent, which is measured when training
    begins. One that learned the key preferences alone is ``preferences=keys``.

    Args:
        interval: environment steps of the training between two measurements.
        episodes: per key.
        keys: run directory whose policy is measured first, with the same objectives; ``None`` is none.
        evaluation: drives them.
        policy: the actor that is measured.
        objectives: names of λ's entries, in order.
        device: where the policy of ``keys`` is put.

    Raises:
        FileNotFoundError: if the run of ``keys`` has no policy.
        ValueError: for numbers below 1, or a policy of ``keys`` with other objectives.
    """

    name = "fit_interpolator"

    def __init__(
        self,
        interval: int = 40_000,
        episodes: int = 12,
        keys: str | None = None,
        *,
        evaluation: Evaluation,
        policy: torch.nn.Module,
        objectives: Sequence[str] = (),
        device: str = "cpu",
    ) -> None:
        super().__init__(interval)
        check_at_least(1, episodes=episodes)
        self.episodes, self.evaluation, self.policy = episodes, evaluation, policy
        self.trained = None if keys is None else deployment.load(keys, device=device)
        if self.trained is not None and self.trained.objectives != tuple(objectives):
            theirs, ours = ", ".join(self.trained.objectives), ", ".join(objectives)
            raise ValueError(f"The policy of {keys} weighs {theirs}, not {ours}.")

    def register(self, trainer: Trainer, name: str | None = None) -> None:
        """Register with a trainer, in whose loss something must need ``keys`` where they are given."""
        super().register(trainer, name)
        if self.trained is not None and not self._terms():
            raise ValueError("FitInterpolator has keys, and no term of the loss an interpolator that needs them.")

    def __call__(self) -> None:
        """Measure and refit if it is due."""
        first = self.trained is not None and not self.last
        if not (terms := self._terms()) or not (first or self.due()):
            return
        self.last = self.trainer.collected_frames
        policy = self.trained.actor if first else self.policy
        loss = self.trainer.loss_module
        gamma = loss.value_estimator.gamma
        for term in terms:
            keys = term.interpolator.preferences
            values = self.evaluation.returns(policy, keys, self.episodes, self.evaluation.seed + 1, gamma)
            values = values.mean(1).to(keys)
            term.update(keys, values)
            expected = utility(values, keys, loss.scalarisation).mean().item()
            log_scalar(self.trainer, "optim/key_utility", expected, self.last)

    def _terms(self) -> list[LossTerm]:
        terms = self.trainer.loss_module.terms.values()
        return [term for term in terms if hasattr(getattr(term, "interpolator", None), "preferences")]
