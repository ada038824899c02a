"""Batched evaluation during training: progress on fixed scenes, and fresh values for the interpolator's keys."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torchrl.trainers.trainers import Trainer, TrainerHookBase

from morlnav.envs import NavigationEnv
from morlnav.evaluation import Outcome, evaluate_policy
from morlnav.objectives import MORLTD3Loss
from morlnav.world import Scene


class EvaluatePolicy(TrainerHookBase):
    """Drive the averaged actor under every preference in the same scenes, log what comes out, and refit the keys.

    Args:
        policy: maps observations and preferences to actions.
        env: gives the world, the objectives and what is observed.
        scenes: fixed scenes ``[S]``.
        preferences: evaluated preferences ``[P, n]``.
        loss: its interpolator learns the discounted value vectors, if it has one.
        frames: environment steps between evaluations.
        max_steps: an episode's time limit.
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
    ) -> None:
        self.policy, self.env, self.scenes, self.preferences = policy, env, scenes, preferences.to(env.device)
        self.loss, self.frames, self.max_steps = loss, frames, max_steps
        self.last = 0

    def __call__(self, batch: Any = None) -> None:
        """Evaluate if it is due."""
        frames = self.trainer.collected_frames
        if frames - self.last < self.frames:
            return
        self.last = frames
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
        discounts = gamma ** torch.arange(rollouts.reward.shape[2], device=gamma.device)
        values = (rollouts.reward * discounts.unsqueeze(-1)).sum(2).mean(1)
        if self.loss.interpolator is not None:
            self.loss.interpolator.update(self.preferences, values)
        for name, value in self._metrics(rollouts, values).items():
            self.trainer.logger.log_scalar(f"evaluation/{name}", value, step=frames)

    def _metrics(self, rollouts: Any, values: Tensor) -> dict[str, float]:
        returns = rollouts.reward.sum(2).mean(1)
        weights = self.loss.scalarisation(self.preferences, returns.shape[-1])
        human = (rollouts.pose[..., :2] - rollouts.scene.human.unsqueeze(2)).norm(dim=-1).amin(-1).mean(1)
        seconds = rollouts.steps.float().mean(1) * self.env.world.step_time
        metrics = {
            "success": (rollouts.outcome == Outcome.GOAL).float().mean().item(),
            "collision_human": (rollouts.outcome == Outcome.HUMAN).float().mean().item(),
            "collision_box": (rollouts.outcome == Outcome.BOX).float().mean().item(),
            "timeout": (rollouts.outcome == Outcome.TIMEOUT).float().mean().item(),
            "expected_utility": (weights * returns).sum(-1).mean().item(),
        }
        for i, row in enumerate(self.preferences.tolist()):
            label = "_".join(f"{weight:.2f}" for weight in row)
            metrics[f"min_human_distance/{label}"] = human[i].item()
            metrics[f"navigation_time/{label}"] = seconds[i].item()
            metrics |= {f"key_{name}/{label}": v for name, v in zip(self.env.rewards, values[i].tolist(), strict=True)}
        return metrics

    def register(self, trainer: Trainer, name: str = "evaluate_policy") -> None:
        """Register after every round of optimisation steps."""
        self.trainer = trainer
        trainer.register_op("post_steps", self)
        trainer.register_module(name, self)

    def state_dict(self) -> dict[str, Any]:
        """When the last evaluation was."""
        return {"last": self.last}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Keep the rhythm of evaluations."""
        self.last = state_dict["last"]
