"""``morlnav-clone STUDY``: how a clone of the demonstrator does under noise, or with fewer demonstrations."""

from __future__ import annotations

import argparse
import copy
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from morlnav.cli import composed, folder, one_sentence_errors, quiet, set_threads
from morlnav.config import check, setting
from morlnav.limits import check_at_least
from morlnav.navigation.audit import Behaviour
from morlnav.navigation.audit.noise import noisy_rollouts
from morlnav.navigation.envs import GoalProgress, NavigationEnv
from morlnav.navigation.evaluation import Outcome, Rollouts, evaluation_scenes
from morlnav.navigation.evaluation.statistics import bootstrap_interval
from morlnav.navigation.record.studies_plot import plot_studies
from morlnav.navigation.world import Scene
from morlnav.runs import make_training
from morlnav.trainers import Training, live_objects
from morlnav.trainers.stages import Driver

LEVELS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
NUMBERS = (1, 3, 10, 30, 100, 300, 1000)
OF_NO_CLONE = re.compile(
    r"[+~]*(actor|critic|loss|stepper|exploration|replay|collector|hooks|logger|refinement|preferences|products|compile"
    r"|trainer\.(?!progress_bar)|evaluation\.(?!seed))"
)
"""Keys of a training that begins when the clone is there."""


class Studies:
    """What a clone of the first demonstrated objective's demonstrator is worth, in held-out scenes.

    Args:
        training: whose demonstrations are cloned.
        episodes: held-out scenes, all of which the demonstrator drives without a collision.

    Raises:
        ValueError: if nobody demonstrates whom a clone could be measured against.
    """

    def __init__(self, training: Training, episodes: int = 20) -> None:
        check_at_least(1, episodes=episodes)
        self.training, self.env = training, training.unpaid_env()
        self.max_steps, self.seed = live_objects(self.env)["max_steps"], training.seed
        if not isinstance(self.env.base_env, NavigationEnv):
            raise ValueError("morlnav-clone drives robots; choose env=navigation.")
        self.world = self.env.base_env.world
        sources = training.pipeline().demonstrations.values() if training.rewards is not None else []
        self.demonstrator = next((source.policy for source in sources), None)
        if self.demonstrator is None:
            raise ValueError("morlnav-clone measures a clone against its demonstrator, and nobody can be asked here.")
        self.scenes = self._free_scenes(episodes)

    def noise(self, levels: Sequence[float] = LEVELS, hold: int = 1) -> pd.DataFrame:
        """Normalised baseline return of the clone under ε-greedy noise (Fig. 2a).

        Args:
            levels: noise levels ``ε``, ascending.
            hold: steps that a random action lasts; 1 as printed.

        Returns:
            A row per level: ``epsilon``, ``baseline`` (1 pays as much as the whole way to the goal) with its bootstrap
            interval ``baseline_low`` and ``baseline_high``, and the demonstrator's own return ``demonstrator``.
        """
        check_at_least(1, hold=hold)
        clone = self._clone()
        driven = noisy_rollouts(
            clone, self.scenes, levels, hold, world=self.world, max_steps=self.max_steps, seed=self.seed
        )
        returns = (driven["reward"][..., 0] * driven["mask"]).sum(-1)
        return self._table("epsilon", levels, returns / self._whole_way())

    def number(self, numbers: Sequence[int] = NUMBERS) -> pd.DataFrame:
        """Normalised baseline return of clones of few and many demonstrations ``N_D`` (Fig. 2b).

        Args:
            numbers: of demonstrations.

        Returns:
            A row per number, as from :meth:`noise`, with ``demonstrations`` in place of ``epsilon``.
        """
        returns = torch.stack([self._baseline(self._clone(number)) for number in numbers])
        return self._table("demonstrations", numbers, returns)

    def _clone(self, number: int | None = None) -> Driver:
        """The clone on whole observations, of as many demonstrations as the config says or of another number."""
        training = copy.copy(self.training)
        if number is not None:
            training.rewards = training.rewards.replace(num=number)
        clone = training.pipeline().clones()[0]
        env = self.env.base_env
        return lambda observation: clone(env.seen(observation))

    def _free_scenes(self, count: int) -> Scene:
        """Held-out scenes in which the demonstrator reaches the goal."""
        seed, sampler = setting(self.training.evaluation, "seed"), self.env.base_env.scenes
        scenes = evaluation_scenes(4 * count, seed=seed, sampler=sampler)
        free = (self._drive(self.demonstrator, scenes).outcome[0] == Outcome.GOAL).nonzero().flatten()[:count]
        if len(free) < count:
            raise ValueError(f"The demonstrator reaches the goal in only {len(free)} of {4 * count} scenes.")
        return scenes[free]

    def _drive(self, policy: Driver, scenes: Scene) -> Rollouts:
        behaviour = Behaviour(lambda observation, _: policy(observation), self.max_steps)
        return behaviour.drive(scenes, world=self.world)

    def _whole_way(self) -> Tensor:
        return GoalProgress().scale * (self.scenes.goal - self.scenes.start[:, :2]).norm(dim=-1)

    def _baseline(self, policy: Driver) -> Tensor:
        """Normalised baseline returns ``[S]``."""
        return self._drive(policy, self.scenes).reward[0, ..., 0].sum(-1) / self._whole_way()

    def _table(self, name: str, values: Sequence[float], returns: Tensor) -> pd.DataFrame:
        rng, best = np.random.default_rng(self.seed), self._baseline(self.demonstrator).mean().item()
        rows = []
        for value, row in zip(values, returns.double().cpu().numpy(), strict=True):
            low, high = bootstrap_interval(row, rng)
            ends = {"baseline_low": low, "baseline_high": high, "demonstrator": best}
            rows.append({name: value, "baseline": row.mean(), **ends})
        return pd.DataFrame(rows)


def main() -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-clone", description=__doc__.split(": ", 1)[1])
    parser.add_argument("study", choices=["noise", "number"], help="Fig. 2a: over ε; Fig. 2b: over demonstrations")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="as of morlnav-train")
    parser.add_argument("--episodes", type=int, default=20, help="held-out scenes (default: 20)")
    parser.add_argument("--hold", type=int, help="noise: steps that a random action lasts (default: 1)")
    parser.add_argument("--output", type=folder, default=Path("outputs/clone"), help="default: outputs/clone")
    args = parser.parse_intermixed_args()
    if args.hold is not None and args.study != "noise":
        parser.error("--hold belongs to noise")
    if args.hold is not None and args.hold < 1:
        parser.error(f"--hold must be at least 1, got {args.hold}")
    with one_sentence_errors(own_classes=True):
        cfg = composed(args.overrides)
        if cfg.resume is not None or cfg.trust:
            raise ValueError("resume and trust belong to morlnav-train; morlnav-clone begins anew.")
        training = make_training(cfg)
        if other := [word for word in args.overrides if OF_NO_CLONE.match(word)]:
            raise ValueError(f"{other[0]} changes no clone, which is there before a policy is trained.")
        check(cfg.threads, "threads", kind=int)
        set_threads(cfg.threads)
        studies = Studies(training, args.episodes)
        table = studies.noise(hold=1 if args.hold is None else args.hold) if args.study == "noise" else studies.number()
        args.output.mkdir(parents=True, exist_ok=True)
        table.to_csv(args.output / f"{args.study}.csv", index=False)
        plot_studies(table).savefig(args.output / f"{args.study}.png", dpi=150)
        print(table.round(3).to_string(index=False))
        print(f"Table and figure are in {args.output}")


if __name__ == "__main__":
    main()
