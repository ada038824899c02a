"""The audit as a stage of a pipeline, and of a reward that is already there."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from morlnav.limits import check_at_least
from morlnav.navigation.audit.report import write_audit
from morlnav.navigation.audit.verdict import audit_reward
from morlnav.navigation.evaluation import evaluation_scenes
from morlnav.navigation.world import Scene, World, without_human


class RewardAudit:
    """Judges a learned reward in the world that it is for, against the demonstrator that it was learned from.

    Args:
        required: a reward that fails ends the pipeline.
        num_scenes: held out, to compare behaviours in.
        scene_seed: of these scenes.
        plans: scenes to plan the reward's best path in; 0 plans none.
        bare: take the boxes out of every second planned scene.
        world: the engine.
        scenes: draws them.
        observe_human: whether the reward sees the human's position.
        max_steps: time limit of an episode.
        seed: of noise and bootstrap.

    Raises:
        ValueError: for numbers out of range.
    """

    def __init__(
        self,
        required: bool = True,
        num_scenes: int = 100,
        scene_seed: int = 0,
        plans: int = 3,
        bare: bool = False,
        *,
        world: World,
        scenes: Callable[..., Scene],
        observe_human: bool = True,
        max_steps: int = 250,
        seed: int = 0,
    ) -> None:
        check_at_least(1, num_scenes=num_scenes)
        check_at_least(0, plans=plans, scene_seed=scene_seed, seed=seed)
        self.required, self.plans, self.bare = required, plans, bare
        self.num_scenes, self.scene_seed = num_scenes, scene_seed
        self.world, self.scenes, self.observe_human = world, scenes, observe_human
        self.max_steps, self.seed = max_steps, seed

    def judge(
        self,
        reward: nn.Module,
        demonstrator: Callable[[Tensor], Tensor],
        output: Path,
        *,
        scale: float = 10.0,
        offset: float = -1.0,
        snippet: int = 25,
    ) -> None:
        """Audit a reward, and write the verdict, tables and figures to ``output``.

        Where that is not possible, as the demonstrator arrives nowhere, it is failed.

        Raises:
            ValueError: for a scale that is not positive, or an offset that is not finite.
        """
        if not 0 < scale < math.inf or not math.isfinite(offset):
            raise ValueError(f"scale must be positive and offset a finite number, got {scale} and {offset}.")
        settings = {"scale": scale, "offset": offset, "snippet": snippet, "max_steps": self.max_steps}
        settings |= {"plans": self.plans, "bare": self.bare, "seed": self.seed}
        try:
            audit = audit_reward(
                reward,
                scenes=evaluation_scenes(self.num_scenes, seed=self.scene_seed, sampler=self.scenes),
                oracle=self._on_whole_observations(demonstrator),
                observe_human=self.observe_human,
                world=self.world,
                **settings,
            )
        except ValueError as error:  # a clone that never arrives cannot stand in for anybody
            output.mkdir(parents=True, exist_ok=True)
            (output / "audit.json").write_text(json.dumps({"passed": False, "reasons": [str(error)]}))
            (output / "audit.md").write_text(f"**Failed.**\n- {error}\n")
            return
        write_audit(audit, output, {"num_scenes": self.num_scenes, "scene_seed": self.scene_seed, **settings})

    def _on_whole_observations(self, policy: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
        """A network sees what it learned from; a hand-written policy sees the human in any case."""
        if self.observe_human or not isinstance(policy, nn.Module) or next(policy.parameters(), None) is None:
            return policy
        return lambda observation: policy(without_human(observation))

    @staticmethod
    def read(report: Path) -> dict[str, Any]:
        """The verdict of :meth:`judge`: ``passed``, ``reasons`` and facts."""
        return json.loads((report / "audit.json").read_text())
