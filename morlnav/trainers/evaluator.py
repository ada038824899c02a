"""Batched evaluation during training: progress on fixed scenes, and fresh values for the interpolator's keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.trainers.trainers import Trainer

from morlnav.envs import NavigationEnv
from morlnav.evaluation import (
    Rollouts,
    episode_metrics,
    evaluate_policy,
    expected_utility,
    preference_label,
    shortest_path,
    summarise,
)
from morlnav.evaluation.statistics import RATES, metric_columns, tuneable_objectives
from morlnav.objectives import MORLTD3Loss
from morlnav.trainers.hooks import PeriodicHook
from morlnav.world import Scene


class EvaluatePolicy(PeriodicHook):
    """Drive the averaged actor under every preference in the same scenes, log what comes out, and refit the keys.

    Args:
        policy: maps observations and preferences to actions.
        env: gives the world, the objectives and what is observed.
        scenes: fixed scenes ``[S]``.
        preferences: evaluated preferences ``[P, n]``.
        loss: its interpolator learns the discounted value vectors, if it has one.
        frames: environment steps between evaluations.
        max_steps: an episode's time limit.
        references: by objective, a demonstrated path ``[L, 2]`` per scene, to log the Fréchet distance to.
    """

    def __init__(
        self,
        policy: nn.Module,
        env: NavigationEnv,
        scenes: Scene,
        preferences: Tensor,
        loss: MORLTD3Loss,
        frames: int,
        max_steps: int,
        references: Mapping[str, Sequence[Tensor]] | None = None,
    ) -> None:
        super().__init__(frames)
        self.policy, self.env, self.scenes, self.preferences = policy, env, scenes, preferences.to(env.device)
        self.loss, self.max_steps, self.references = loss, max_steps, references or {}
        self.shortest = shortest_path(scenes, env.world.robot.radius, env.world.human_radius, env.world.goal_radius)

    def __call__(self, batch: Any = None) -> None:
        """Evaluate if it is due."""
        if not self.due():
            return
        rollouts = evaluate_policy(
            self.policy,
            self.scenes,
            self.preferences,
            world=self.env.world,
            objectives=self.env.rewards,
            observe_human=self.env.observe_human,
            max_steps=self.max_steps,
        )
        gamma = self.loss.value_estimator.gamma
        discounts = gamma ** torch.arange(rollouts.reward.shape[2], device=gamma.device).unsqueeze(-1)
        values = (rollouts.reward * discounts).sum(2).mean(1)
        if self.loss.interpolator is not None:
            self.loss.interpolator.update(self.preferences, values)
        for name, value in self._metrics(rollouts, values).items():
            self.trainer.logger.log_scalar(f"evaluation/{name}", value, step=self.last)

    def _metrics(self, rollouts: Rollouts, values: Tensor) -> dict[str, float]:
        rewards = self.env.rewards
        episodes = episode_metrics(
            rollouts, tuple(rewards), world=self.env.world, references=self.references, shortest=self.shortest
        )
        metrics = episodes[[name for names in RATES.values() for name in names]].mean().to_dict()
        metrics["expected_utility"] = expected_utility(rollouts.reward.sum(2).mean(1), self.preferences)
        summary = summarise(episodes, resamples=2)  # its means alone are wanted
        for row, keys in zip(summary.to_dict("records"), values.tolist(), strict=True):
            names = tuneable_objectives(episodes)
            label = preference_label(names, [row[f"lambda_{name}"] for name in names])
            metrics[f"success/{label}"] = row["SR"] / 100
            metrics |= {f"{name}/{label}": row[name] for name in metric_columns(episodes)}
            metrics |= {f"key_{name}/{label}": key for name, key in zip(rewards, keys, strict=True)}
        return metrics

    def register(self, trainer: Trainer, name: str = "evaluate_policy") -> None:
        """Register after every round of optimisation steps."""
        self.trainer = trainer
        trainer.register_op("post_steps", self)
        trainer.register_module(name, self)
