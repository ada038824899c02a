"""The evaluation of a navigating policy: social metrics, styles and trajectories besides the front."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from torch import Tensor, nn
from torchrl.envs import EnvBase, TransformedEnv
from tqdm import tqdm

from morlnav.data import simplex_grid
from morlnav.evaluation import Evaluation, eval_env, preference_label
from morlnav.evaluation.pareto import utility
from morlnav.navigation.envs import NavigationEnv, Objective, Transition
from morlnav.navigation.evaluation.metrics import episode_metrics
from morlnav.navigation.evaluation.paths import shortest_path
from morlnav.navigation.evaluation.planner import PathPlanner
from morlnav.navigation.evaluation.possible import EDGE, ExactFront, best_utility, exact_front, possible_table
from morlnav.navigation.evaluation.references import reference_paths
from morlnav.navigation.evaluation.report import sentences, write_report
from morlnav.navigation.evaluation.rollout import Rollouts, evaluate_policy, evaluation_scenes
from morlnav.navigation.evaluation.statistics import RATES, metric_columns, overall, summarise
from morlnav.navigation.world import Scene
from morlnav.record.console import make_console
from morlnav.trainers.drex import place
from morlnav.transforms import DemonstrationReward, transforms_of

_Known = tuple[Scene, Tensor, dict[str, list[Tensor]], ExactFront | None, Tensor | None]
"""Scenes, their shortest paths, demonstrators' paths, the exact front, and what the best known paths are worth."""


class NavigationEvaluation(Evaluation):
    """Drives every preference in the same held-out scenes, side by side, with the robot's true size.

    Args:
        episodes: scenes per preference.
        demonstrators: by objective, who drives as demonstrated, to measure Fréchet distances to.
        max_steps: time limit of an episode.
        plan: let reports tell regrets from the best path under each learned reward, too, planned in every scene; takes
            minutes.
        settings: further arguments of :class:`~morlnav.evaluation.Evaluation`; its seed is that of the scenes.

    Raises:
        ValueError: for numbers out of range, or an environment of another kind.
    """

    def __init__(
        self,
        episodes: int = 100,
        *,
        demonstrators: Mapping[str, Callable[[Tensor], Tensor]],
        max_steps: int = 250,
        plan: bool | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(episodes, max_steps=max_steps, **settings)
        self.demonstrators, self.plan = demonstrators, plan
        self._scenes: Scene | None = None
        self._known: dict[tuple[int, int], _Known] = {}
        if not isinstance(self.env, NavigationEnv):
            raise ValueError(f"NavigationEvaluation measures a NavigationEnv, and no {type(self.env).__name__}.")

    @cached_property
    def env(self) -> NavigationEnv:
        """The bare environment, whose world and objectives are measured in."""
        return self._transformed.base_env

    @cached_property
    def terms(self) -> dict[str, Objective]:
        """Every entry of the reward as an objective, learned ones too."""
        return reward_terms(self._transformed)

    @cached_property
    def _transformed(self) -> TransformedEnv:
        return eval_env(self.make_env(num_envs=1))

    def drive(self, policy: nn.Module, scenes: Scene, preferences: Tensor) -> Rollouts:
        """Episodes ``[P, S]`` of a policy under preferences ``[P, n]`` or schedules ``[P, T, n]`` in scenes ``[S]``."""
        env = self.env
        return evaluate_policy(
            policy,
            scenes,
            preferences.to(env.device),
            world=env.world,
            objectives=self.terms,
            observe_human=env.observe_human,
            max_steps=self.max_steps,
        )

    def scenes(self, episodes: int | None = None, seed: int | None = None) -> Scene:
        """Held-out scenes, or those to :meth:`use`."""
        if self._scenes is not None and episodes is None and seed is None:
            return self._scenes
        return evaluation_scenes(
            self.episodes if episodes is None else episodes,
            seed=self.seed if seed is None else seed,
            sampler=self.env.scenes,
        )

    def use(self, scenes: Scene) -> None:
        """Drive in these scenes ``[S]`` from now on, and no longer in held-out ones.

        Raises:
            ValueError: naming the first scene that the world's robot cannot stand in, or whose goal is further than it
                could drive in the time of an episode.
        """
        world = self.env.world
        reach = world.robot.max_speed * world.step_time * self.max_steps + world.goal_radius
        for number, scene in enumerate(scenes):
            try:
                scene.check(world.robot.radius, world.human_radius)
            except ValueError as error:
                raise ValueError(f"Episode {number}: {error}") from error
            distance = (scene.goal - scene.start[:2]).norm()
            if distance > reach:
                raise ValueError(
                    f"Episode {number}: the goal is {distance:.1f} m away, but after the {self.max_steps} steps of an "
                    f"episode the robot is {reach:.1f} m away at most."
                )
        self._scenes, self.episodes = scenes, len(scenes)

    def references(self, scenes: Scene) -> dict[str, list[Tensor]]:
        """Each demonstrator's path in each scene, where it can drive there."""
        paths = {}
        for name, policy in self.demonstrators.items():
            try:
                paths[name] = reference_paths(scenes, policy, world=self.env.world, max_steps=self.max_steps)
            except ValueError as error:
                print(f"No Fréchet distances to the demonstration of {name}: {error}")
        return paths

    def plans(self, scenes: Scene) -> dict[str, list[Tensor]]:
        """The best path ``[L, 2]`` under each learned reward in each scene; takes seconds for each."""
        paths = {}
        for name, term in self.terms.items():
            if isinstance(term, _Demonstrated):
                learned, env = term.transform, self.env
                planner = PathPlanner(
                    learned.scale, learned.offset, env.world, env.observe_human, max_steps=self.max_steps
                )
                shown = tqdm(scenes, desc=f"plans for {name}", leave=False, disable=None)  # where somebody looks
                paths[name] = [planner(learned.reward_model, scene).path for scene in shown]
        return paths

    def returns(
        self, policy: nn.Module, preferences: Tensor, episodes: int, seed: int, gamma: Tensor | float = 1.0
    ) -> Tensor:
        """See :meth:`Evaluation.returns`; all preferences side by side."""
        reward = self.drive(policy, self.scenes(episodes, seed), preferences).reward
        discounts = torch.as_tensor(gamma).to(reward) ** torch.arange(reward.shape[2], device=reward.device)[:, None]
        return (reward * discounts).sum(2)

    def measure(self, policy: nn.Module, episodes: int, steps: int) -> dict[str, float]:
        """See :meth:`Evaluation.measure`."""
        preferences = simplex_grid(self.num_objectives, steps)
        scenes, shortest, references, front, best = self._fixed(episodes, preferences)
        rollouts = self.drive(policy, scenes, preferences)
        frame = episode_metrics(rollouts, self.rewards, world=self.env.world, references=references, shortest=shortest)
        metrics = frame[[name for names in RATES.values() for name in names]].mean().to_dict()
        earned = utility(rollouts.reward.sum(2).mean(1).cpu(), preferences, self.scalarisation)
        metrics["expected_utility"] = earned.mean().item()
        summary = summarise(frame, resamples=2)  # its means alone are wanted
        if front is not None:
            possible = possible_table(front, summary, pd.Series(earned.numpy()), best)
            metrics |= {name: possible[name].iloc[0] for name in ("front_share", "mean_excess")}
            summary["regret"] = possible["regret"]
        for preference, row in zip(preferences, summary.to_dict("records"), strict=True):
            label = preference_label(self.objectives, preference.tolist())
            metrics[f"success/{label}"] = row["SR"] / 100
            metrics |= {f"{name}/{label}": row[name] for name in [*metric_columns(frame), "regret"] if name in row}
        return metrics

    def _fixed(self, episodes: int, preferences: Tensor) -> _Known:
        """Scenes that stay the same while a policy learns, with what is known of them."""
        key = episodes, len(preferences)
        if key not in self._known:
            scenes, world = self.scenes(episodes, self.seed + 1), self.env.world
            front = exact_front(scenes, world) if set(EDGE) <= set(self.objectives) else None
            radii = world.robot.radius, world.human_radius, world.goal_radius
            shortest = shortest_path(scenes, *radii) if front is None else front.length[:, 0]
            references, best = self.references(scenes), None
            if front is not None:
                settings = {"world": world, "references": references, "scalarisation": self.scalarisation}
                best = best_utility(front, scenes, preferences, self.terms, **settings)
            self._known[key] = scenes, shortest, references, front, best
        return self._known[key]

    def report(self, policy: nn.Module, directory: Path) -> None:
        """Measure a trained policy, and write tables and figures (see :func:`write_report`)."""
        scenes = self.scenes()
        rollouts = self.drive(policy, scenes, self.preferences())
        write_report(
            rollouts,
            directory,
            rewards=self.rewards,
            world=self.env.world,
            references=self.references(scenes),
            reference_point=self.reference,
            scalarisation=self.scalarisation,
            objectives=self.terms,
            plans=self.plans(scenes) if self.plan else None,
        )

    def show(self, output: Path, directory: Path) -> None:
        """See :meth:`Evaluation.show`."""
        from morlnav.navigation.evaluation.tables import audit_line, print_summary

        tables = {path.stem: pd.read_csv(path) for path in output.glob("*.csv")}
        episodes, summary = tables.pop("episodes"), tables["summary"]
        console, demonstrated = make_console(), list(self.demonstrators)
        print_summary(summary, overall(episodes, resamples=2), demonstrated=demonstrated, console=console)
        audits = [audit_line(place(directory, name) / "audit", name) for name in demonstrated]
        for line in [*sentences(**tables), *filter(None, audits)]:
            console.print(line)
        console.print(f"All rows and columns are in {output / 'table.md'}", soft_wrap=True)

    def show_rooms(self, file: Path) -> None:
        """Print in a terminal how the policy drives in several rooms."""
        from morlnav.navigation.evaluation.tables import print_summary

        print_summary(pd.read_csv(file), label="room", demonstrated=list(self.demonstrators))


def reward_terms(env: EnvBase) -> dict[str, Objective]:
    """The entries of an environment's reward as objectives, with what its transforms add.

    Examples:
        >>> slow = lambda observation, action: 1 - action[..., 0] / 0.5
        >>> terms = reward_terms(TransformedEnv(NavigationEnv(), DemonstrationReward(slow)))
        >>> list(terms)
        ['baseline', 'demo', 'distance', 'efficiency']
        >>> NavigationEnv(objectives=terms).rollout(2)["next", "reward"].shape  # also without TorchRL's transforms
        torch.Size([2, 4])
    """
    base = env.base_env if isinstance(env, TransformedEnv) else env
    items = list(base.rewards.items())
    for transform in transforms_of(env):
        if isinstance(transform, DemonstrationReward):
            entry, term = transform.entry, _Demonstrated(transform, base)
            if transform.insert:
                items.insert(entry, (transform.name, term))
            else:
                items[entry] = (items[entry][0], term)
    return dict(items)


class _Demonstrated:
    """A learned reward as an objective."""

    def __init__(self, transform: DemonstrationReward, env: NavigationEnv) -> None:
        self.transform, self.env = transform, env

    def __call__(self, transition: Transition) -> Tensor:
        return self.transform.reward(self.env.seen(transition.observation), transition.action)

    def bounds(self, reach: float) -> tuple[float, float]:
        return self.transform.bounds()
