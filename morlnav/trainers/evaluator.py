"""Batched evaluation during training: progress on fixed scenes, and fresh values for the interpolator's keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.trainers.trainers import Trainer

from morlnav.envs import NavigationEnv
from morlnav.evaluation import Outcome, Rollouts, evaluate_policy, frechet_distance
from morlnav.evaluation.metrics import frechet_column, winding
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
        returns = rollouts.reward.sum(2).mean(1)
        weights = self.loss.scalarisation(self.preferences, returns.shape[-1])
        human = (rollouts.pose[..., :2] - rollouts.scene.human.unsqueeze(2)).norm(dim=-1).amin(-1)
        reached = (rollouts.outcome == Outcome.GOAL).float()
        metrics = {
            "success": reached.mean().item(),
            "collision_human": (rollouts.outcome == Outcome.HUMAN).float().mean().item(),
            "collision_box": (rollouts.outcome == Outcome.BOX).float().mean().item(),
            "timeout": (rollouts.outcome == Outcome.TIMEOUT).float().mean().item(),
            "expected_utility": (weights * returns).sum(-1).mean().item(),
        }
        columns = {
            "success": reached.mean(1),
            "min_human_distance": human.mean(1),
            "navigation_time": rollouts.steps.float().mean(1) * self.env.world.step_time,
            "human_on_right": (winding(rollouts.pose, rollouts.scene.human) < 0).float().mean(1),
            **{f"return_{name}": returns[:, i] for i, name in enumerate(self.env.rewards)},
            **{f"key_{name}": values[:, i] for i, name in enumerate(self.env.rewards)},
        }
        for name, lines in self.references.items():
            frechet = [frechet_distance(paths, lines) for paths in rollouts.cpu().path]
            columns[frechet_column(name)] = torch.stack(frechet).mean(1)
        for i, row in enumerate(self.preferences.tolist()):
            label = "_".join(f"{weight:.2f}" for weight in row)
            metrics |= {f"{name}/{label}": column[i].item() for name, column in columns.items()}
        return metrics

    def register(self, trainer: Trainer, name: str = "evaluate_policy") -> None:
        """Register after every round of optimisation steps."""
        self.trainer = trainer
        trainer.register_op("post_steps", self)
        trainer.register_module(name, self)
