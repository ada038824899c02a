"""Demonstrations in the replay buffer from the beginning."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torchrl.trainers.trainers import Trainer, TrainerHookBase

from morlnav.data import PreferenceSampler
from morlnav.navigation.demonstrations.record import rewarded_transitions
from morlnav.navigation.evaluation import NavigationEvaluation
from morlnav.trainers import LearnedReward


class SeedReplay(TrainerHookBase):
    """Fills a trainer's replay buffer with demonstrations, paid as the environment pays; new transitions replace them.

    A resumed run gets them from its checkpoint.

    Args:
        learned: rewards with the demonstrations that they were learned from.
        sampler: draws the preferences that they are stored with.
        evaluation: knows every entry of the reward.

    Raises:
        ValueError: if observations do not hold the human's position, which rewards are computed from.

    Examples:
        >>> SeedReplay(learned, sampler, evaluation=evaluation).register(trainer)  # doctest: +SKIP
    """

    def __init__(
        self, learned: Mapping[str, LearnedReward], sampler: PreferenceSampler, *, evaluation: NavigationEvaluation
    ) -> None:
        if not evaluation.env.observe_human:
            raise ValueError("Demonstrations can be replayed with env.observe_human=true only: rewards need the human.")
        self.demonstrations = [
            reward.demonstrations for reward in learned.values() if reward.demonstrations is not None
        ]
        self.sampler, self.terms, self.env = sampler, evaluation.terms, evaluation.env

    def register(self, trainer: Trainer, name: str = "seed_replay") -> None:
        """Fill the trainer's replay buffer."""
        for data in self.demonstrations:
            rows = rewarded_transitions(data.to(self.env.device), self.terms)
            rows = rows.select("observation", "action", "next")
            rows["preference"] = rows["next", "preference"] = self.sampler(len(rows), device=self.env.device)
            trainer.replay_buffer.extend(rows)

    def state_dict(self) -> dict[str, Any]:
        """Nothing: a checkpoint holds the buffer."""
        return {}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Nothing to load."""
