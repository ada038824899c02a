"""Where a pipeline gets its demonstrations from: a policy in random scenes, or a recording."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from morlnav.limits import check_at_least
from morlnav.navigation.audit import Thresholds
from morlnav.navigation.demonstrations.folder import (
    check_world,
    demonstrations_digest,
    load_demonstrations,
    save_demonstrations,
)
from morlnav.navigation.demonstrations.record import Disturbance, record_demonstrations
from morlnav.navigation.demonstrations.replay import recorded_demonstrations
from morlnav.navigation.evaluation import evaluate_policy, frechet_distance
from morlnav.navigation.world import Scene, World
from morlnav.trainers import Demonstrations


class NavigationDemonstrations(Demonstrations):
    """Base of both: demonstrations are kept as ``morlnav-record`` keeps them.

    Args:
        world: the engine.
        scenes: draws random scenes.
        observe_human: whether the human's position is recorded (``-NH`` ablation).
        max_steps: time limit of an episode.
        seed: of scenes and disturbances.
        num_envs: episodes side by side.
    """

    tries = 0
    """Episodes that were tried for the demonstrations."""

    def __init__(
        self,
        world: World,
        scenes: Callable[..., Scene],
        observe_human: bool = True,
        max_steps: int = 250,
        seed: int = 0,
        num_envs: int = 256,
    ) -> None:
        check_at_least(1, num_envs=num_envs)
        self.world, self.scenes, self.observe_human = world, scenes, observe_human
        self.max_steps, self.seed, self.num_envs = max_steps, seed, num_envs

    def save(self, data: TensorDict, path: Path) -> None:
        """See :meth:`Demonstrations.save`."""
        save_demonstrations(data, path, {"tries": self.tries}, self.world)

    def load(self, path: Path) -> TensorDict:
        """See :meth:`Demonstrations.load`."""
        return load_demonstrations(path)


class RecordedPolicy(NavigationDemonstrations):
    """Successful episodes of a hand-written policy in random scenes (:func:`record_demonstrations`).

    Args:
        policy: maps raw observations ``[B, 34]`` to actions ``[B, 2]``; it sees the human in any case.
        disturbance: pushes the robot; ``None`` leaves it alone.
        settings: arguments of :class:`NavigationDemonstrations`.

    Raises:
        ValueError: if the policy is faster than the robot.
    """

    def __init__(
        self,
        policy: Callable[[Tensor], Tensor],
        disturbance: Disturbance | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        speed, limit = getattr(policy, "speed", 0.0), self.world.robot.max_speed
        if speed > limit:
            raise ValueError(f"policy.speed must be at most the robot's {limit} m/s, got {speed}.")
        self.policy, self.disturbance = policy, disturbance

    def collect(self, num: int) -> TensorDict:
        """See :meth:`Demonstrations.collect`."""
        data, self.tries = record_demonstrations(
            self.policy,
            self.scenes,
            num,
            world=self.world,
            disturbance=self.disturbance,
            observe_human=self.observe_human,
            seed=self.seed,
            max_steps=self.max_steps,
            num_envs=self.num_envs,
        )
        return data


class RecordedFolder(NavigationDemonstrations):
    """Demonstrations of your own: a folder that ``morlnav-record`` wrote (:func:`recorded_demonstrations`).

    Nobody can be asked again how to drive, so the clone stands in for whoever was recorded, and has to drive as
    recorded.

    Args:
        path: of the folder, or a list of several.
        replay: replay them among random boxes until as many are free of collisions as the pipeline wants; otherwise
            they are taken as they are.
        settings: arguments of :class:`NavigationDemonstrations`.

    Raises:
        FileNotFoundError: if a folder holds no demonstrations.
        ValueError: if they were recorded in another world.
    """

    def __init__(self, path: str | list[str], replay: bool = False, **settings: Any) -> None:
        super().__init__(**settings)
        for folder in [path] if isinstance(path, str) else path:
            check_world(folder, self.world)
        self.path, self.replay, self.key = path, replay, demonstrations_digest(path)

    def collect(self, num: int) -> TensorDict:
        """See :meth:`Demonstrations.collect`."""
        data, self.tries = recorded_demonstrations(
            self.path,
            self.scenes,
            num if self.replay else None,
            world=self.world,
            observe_human=self.observe_human,
            seed=self.seed,
            num_envs=self.num_envs,
        )
        return data

    def judge(
        self, clone: Callable[[Tensor], Tensor], data: TensorDict, episodes: int = 100
    ) -> tuple[dict[str, Any], list[str]]:
        """Whether the clone drives as recorded: the median Fréchet distance to the recorded paths."""
        first = (data["step"] == 0).nonzero().flatten()
        bounds = [*first.tolist(), len(data)]
        paths = [
            torch.cat([data["pose"][start:end], data["next", "pose"][end - 1 : end]])[:, :2]
            for start, end in pairwise(bounds[: episodes + 1])
        ]
        rollouts = evaluate_policy(
            lambda observation, _: clone(observation),
            Scene.from_tensordict(data["scene"][first[:episodes]]),
            torch.zeros(1, 2),
            world=self.world,
            observe_human=self.observe_human,
            max_steps=self.max_steps,
        )
        median, allowed = frechet_distance(rollouts.path[0], paths).median().item(), Thresholds().frechet
        reason = f"The clone drives {median:.2f} m off the recorded paths, at most {allowed} m is allowed."
        return {"clone": {"frechet": median, "episodes": len(paths)}}, [] if median <= allowed else [reason]
