"""Keeps what a loss's terms know of the policy's returns current, in any environment."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torchrl.trainers.trainers import Trainer

from morlnav import deployment
from morlnav.config import classes
from morlnav.evaluation import Evaluation, utility
from morlnav.limits import check_at_least
from morlnav.objectives.terms.base import LossTerm
from morlnav.sentences import first_line
from morlnav.trainers.hooks import PeriodicHook, log_scalar


class FitInterpolator(PeriodicHook):
    """Measure the value of every key preference by roll-outs of the averaged actor, and refit interpolators to them.

    It serves every term of the trainer's loss that has an ``interpolator``, such as the angle. A key's value is the
    mean discounted return vector of some episodes, the same for every key, with the loss's present discount.

    PD-MORL takes its key values from agents that were trained before, so that values are not drawn toward directions
    that nothing has reached yet. ``keys`` names the run of such an agent, as one with ``preferences=keys``: it is
    measured beside the actor, from the first updates on, and each key keeps the better value of both.

    Args:
        interval: environment steps of the training between two measurements.
        episodes: per key.
        keys: run directory of a policy with the same objectives and observations; ``None`` is none.
        evaluation: drives them.
        policy: the actor that is measured.
        objectives: names of λ's entries, in order.
        size: numbers of an observation.
        device: where the policy of ``keys`` is put.

    Raises:
        FileNotFoundError: if the run of ``keys`` has no policy.
        ValueError: for numbers below 1, a policy of ``keys`` that is damaged, does not fit or is made of other foreign
            classes than ``policy``, and when registered, if nothing needs ``keys``.
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
        size: int = 1,
        device: str = "cpu",
    ) -> None:
        super().__init__(interval)
        check_at_least(1, episodes=episodes)
        self.episodes, self.evaluation, self.policies = episodes, evaluation, [policy]
        if keys is not None:
            known = {name for module in policy.modules() for name in classes(type(module))}
            trained = deployment.load(keys, known, device)
            if trained.objectives != tuple(objectives):
                theirs, ours = ", ".join(trained.objectives), ", ".join(objectives)
                raise ValueError(f"The policy of {keys} weighs {theirs}, not {ours}.")
            try:
                trained.actor(torch.zeros(size, device=device), torch.ones(len(objectives), device=device))
            except (ValueError, RuntimeError) as error:
                raise ValueError(f"The policy of {keys} cannot drive here: {first_line(error)}") from error
            self.policies.append(trained.actor)

    def register(self, trainer: Trainer, name: str | None = None) -> None:
        """Register with a trainer."""
        super().register(trainer, name)
        if len(self.policies) > 1 and not self._terms():
            raise ValueError("FitInterpolator has keys, and no term of the loss an interpolator that needs them.")

    def __call__(self) -> None:
        """Measure and refit if it is due."""
        first = len(self.policies) > 1 and not self.last
        if not (terms := self._terms()) or not (first or self.due()):
            return
        self.last = self.trainer.collected_frames
        loss = self.trainer.loss_module
        gamma = loss.value_estimator.gamma
        for term in terms:
            keys = term.interpolator.preferences
            seed = self.evaluation.seed + 1
            values = [self.evaluation.returns(each, keys, self.episodes, seed, gamma) for each in self.policies]
            values = torch.cat(values).mean(1).to(keys)
            term.update(keys.repeat(len(self.policies), 1), values)
            expected = utility(values[: len(keys)], keys, loss.scalarisation).mean().item()
            log_scalar(self.trainer, "optim/key_utility", expected, self.last)

    def _terms(self) -> list[LossTerm]:
        terms = self.trainer.loss_module.terms.values()
        return [term for term in terms if hasattr(getattr(term, "interpolator", None), "preferences")]
