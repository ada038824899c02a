"""Measures a policy over the whole simplex of preferences, while it learns and in the end; in any environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pandas as pd
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import EnvBase

from morlnav.evaluation.front import describe_front, front_table, read_reference, reference_from_bounds
from morlnav.evaluation.labels import preference_label
from morlnav.evaluation.pareto import expected_utility
from morlnav.evaluation.returns import discounted_returns, eval_env
from morlnav.limits import check_at_least
from morlnav.record.markdown import markdown_table
from morlnav.simplex import preference_edges, simplex_grid

HELD_OUT = 2**31
"""Episodes of an evaluation are seeded from here on, those of a training below it."""


class Evaluation:
    """Mean returns per preference, and the quality of the front that they make.

    Args:
        episodes: per preference.
        steps: preferences are all pairwise interpolations of corners in so many steps.
        seed: of the episodes, which no training sees.
        reference: reference point of the hypervolume, a number per reward or by name; ``None`` takes one below the
            worst that the rewards can add up to.
        make_env: ``make_env(num_envs=...)`` makes an environment that keeps a preference handed to ``reset``.
        rewards: names of the entries of the reward, static ones first.
        num_objectives: entries of λ.
        reward_bounds: least and largest reward of a step, ``[2, m]``.
        scalarisation: weighs the returns in a utility, as the loss does; by default the paper's ``[1, λ]``.
        max_steps: time limit of an episode.

    Raises:
        ValueError: for numbers out of range, or a reference point that does not fit.
    """

    def __init__(
        self,
        episodes: int = 10,
        steps: int = 10,
        seed: int = 12345,
        reference: Sequence[float] | Mapping[str, float] | None = None,
        *,
        make_env: Callable[..., EnvBase],
        rewards: Sequence[str],
        num_objectives: int,
        reward_bounds: Tensor,
        scalarisation: nn.Module | None = None,
        max_steps: int = 1000,
    ) -> None:
        check_at_least(1, episodes=episodes, steps=steps)
        if not 0 <= seed < HELD_OUT:
            raise ValueError(f"seed must be a whole number from 0 to 2**31 - 1, got {seed}.")
        self.episodes, self.steps, self.seed = episodes, steps, seed
        self.make_env, self.rewards = make_env, tuple(rewards)
        self.num_objectives, self.max_steps = num_objectives, max_steps
        self.scalarisation = scalarisation
        self.reference = read_reference(reference, self.rewards, reference_from_bounds(reward_bounds, max_steps))

    @property
    def objectives(self) -> tuple[str, ...]:
        """Names of the tuneable entries."""
        return self.rewards[len(self.rewards) - self.num_objectives :]

    @property
    def known_reference(self) -> Tensor | None:
        """The reference point ``[m]``; ``None`` where a reward has no least value and no point was given."""
        return self.reference if self.reference.isfinite().all() else None

    def preferences(self, steps: int | None = None) -> Tensor:
        """The evaluated preferences ``[P, n]``."""
        return preference_edges(self.num_objectives, self.steps if steps is None else steps)

    def measure(self, policy: nn.Module, episodes: int, steps: int) -> dict[str, float]:
        """Scalars of a policy that is still learning, on episodes of their own.

        Args:
            policy: maps observations ``[..., D]`` and preferences ``[..., n]`` to actions.
            episodes: per preference.
            steps: of the grid of preferences.
        """
        preferences = simplex_grid(self.num_objectives, steps)
        means = self.returns(policy, preferences, episodes, self.seed + 1).mean(1)
        metrics = {"expected_utility": expected_utility(means, preferences, self.scalarisation)}
        for preference, row in zip(preferences, means.tolist(), strict=True):
            label = preference_label(self.objectives, preference.tolist())
            metrics |= {f"return_{name}/{label}": value for name, value in zip(self.rewards, row, strict=True)}
        return metrics

    def report(self, policy: nn.Module, directory: Path) -> None:
        """Measure a trained policy, and write ``front.csv``, ``table.md`` and ``front.png``."""
        preferences = self.preferences()
        returns = self.returns(policy, preferences, self.episodes, self.seed)
        table = front_table(preferences, returns, self.rewards, self.known_reference, self.scalarisation)
        directory.mkdir(parents=True, exist_ok=True)
        table.to_csv(directory / "front.csv", index=False)
        shown = markdown_table(_shown(table), _shown(table).map("{:.4g}".format).to_numpy())
        text = f"{shown}\n\n{self.episodes} episodes per preference. {describe_front(table)}"
        if self.num_objectives > 1:
            from morlnav.evaluation.front_plot import plot_front  # loads matplotlib

            plot_front(table).savefig(directory / "front.png", dpi=150)
        (directory / "table.md").write_text(text + "\n", encoding="utf-8")  # last: with it a run has finished

    def show(self, output: Path, directory: Path) -> None:
        """Print in a terminal what :meth:`report` wrote to ``output``, for the run in ``directory``."""
        from morlnav.record.console import make_console, print_table

        table, console = pd.read_csv(output / "front.csv"), make_console()
        print_table(_shown(table), console)
        console.print(describe_front(table))

    @staticmethod
    def utility(output: Path) -> float:
        """The expected utility that :meth:`report` wrote to ``output``."""
        return float(pd.read_csv(output / "front.csv")["expected_utility"].iloc[0])

    def returns(
        self, policy: nn.Module, preferences: Tensor, episodes: int, seed: int, gamma: Tensor | float = 1.0
    ) -> Tensor:
        """Return vectors ``[P, E, m]`` of a policy, with the same ``E`` held-out episodes for each preference.

        Args:
            policy: maps observations ``[..., D]`` and preferences ``[..., n]`` to actions.
            preferences: λ, ``[P, n]``.
            episodes: ``E``.
            seed: of the episodes.
            gamma: discount, one for all or one per entry of the reward ``[m]``.
        """
        env = eval_env(self.make_env(num_envs=episodes))
        driver = TensorDictModule(policy, ["observation", "preference"], ["action"])
        try:
            return discounted_returns(env, driver, preferences, self.max_steps, gamma, HELD_OUT + seed).cpu()
        finally:
            env.close()


def _shown(table: pd.DataFrame) -> pd.DataFrame:
    """The columns of a front that a person reads, under names that a person reads."""
    names = [name for name in table if name.startswith(("lambda_", "return_")) or name == "utility"]
    return table[names].rename(columns=lambda name: name.replace("lambda_", "λ ").replace("_", " "))
