"""Everything that an evaluation has to say, written into one directory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
import torch
from torch import Tensor

from morlnav.evaluation.pareto import expected_utility, hypervolume, pareto_mask, utility
from morlnav.navigation.evaluation.metrics import episode_metrics, frechet_column
from morlnav.navigation.evaluation.rollout import Rollouts
from morlnav.navigation.evaluation.statistics import compare_extremes, fidelity, overall, summarise, tuneable_objectives
from morlnav.navigation.world import World

TABLE = {
    "SR": ("SR %", 1),
    "CR": ("CR %", 1),
    "TR": ("TR %", 1),
    "navigation_time": ("time s", 1),
    "time_ratio": ("time ratio", 2),
    "spl": ("SPL", 2),
    "min_human_distance": ("min d_h m", 2),
    "min_obstacle_distance": ("min d_obst m", 2),
    "frechet": ("Fréchet m", 2),
    "frechet_free": ("where free", 2),
    "human_on_right": ("on right", 2),
    "personal_space": ("personal space", 2),
}
"""Columns of the readable table: heading and digits."""

PLOTTED = ("navigation_time", "frechet", "min_obstacle_distance", "min_human_distance")


def default_reference(num_objectives: int, num_tuneable: int, max_steps: int = 250) -> Tensor:
    """A reference point for the hypervolume: what the paper's rewards pay in the worst episode, ``[m]``.

    A collision (-1000) without progress for each static objective, and -10 on each of ``max_steps`` steps for each
    tuneable one (Sec. III-D). Choose your own for other reward scales.

    >>> default_reference(3, 2)
    tensor([-1000., -2500., -2500.])
    """
    return torch.tensor([-1000.0] * (num_objectives - num_tuneable) + [-10.0 * max_steps] * num_tuneable)


def front_table(rollouts: Rollouts, rewards: Sequence[str], reference: Tensor | None = None) -> pd.DataFrame:
    """The front of mean return vectors, one row per preference.

    Args:
        rollouts: batched ``[P, S]``.
        rewards: names of all ``m`` entries of the reward, static ones first.
        reference: reference point of the hypervolume ``[m]``; :func:`default_reference` if ``None``.

    Returns:
        Columns ``lambda_<name>``, ``return_<name>`` (means over scenes), ``utility`` ``= wᵀR``, ``non_dominated``, and,
        the same in every row, ``hypervolume`` and ``expected_utility`` of the whole front.

    Raises:
        ValueError: if the number of names or the reference point does not fit the rewards.

    Examples:
        >>> from morlnav.navigation.evaluation.rollout import evaluate_policy, evaluation_scenes
        >>> straight = lambda observation, preference: torch.tensor([0.5, 0.0]).expand(len(observation), 2)
        >>> rollouts = evaluate_policy(straight, evaluation_scenes(2), torch.eye(2), max_steps=5)
        >>> front_table(rollouts, ["baseline", "distance", "efficiency"])["return_efficiency"].tolist()
        [-50.0, -50.0]
    """
    rollouts = rollouts.cpu()
    preferences, returns = rollouts.preference[:, 0], rollouts.reward.double().sum(-2).mean(1)
    num_objectives, num_tuneable = returns.shape[1], preferences.shape[1]
    if len(rewards) != num_objectives:
        raise ValueError(f"The rewards have {num_objectives} entries, but {len(rewards)} are named.")
    if reference is None:
        reference = default_reference(num_objectives, num_tuneable)
    tuneable = rewards[num_objectives - num_tuneable :]
    columns = {f"lambda_{name}": preferences[:, i].double().round(decimals=6) for i, name in enumerate(tuneable)}
    columns |= {f"return_{name}": returns[:, i] for i, name in enumerate(rewards)}
    columns |= {"utility": utility(returns, preferences), "non_dominated": pareto_mask(returns)}
    table = pd.DataFrame({name: value.numpy() for name, value in columns.items()})
    table["hypervolume"] = hypervolume(returns, reference.cpu())
    table["expected_utility"] = expected_utility(returns, preferences)
    return table


def write_report(
    rollouts: Rollouts,
    directory: str | Path,
    rewards: Sequence[str] = ("baseline", "distance", "efficiency"),
    *,
    world: World | None = None,
    references: Sequence[Tensor] | Mapping[str, Sequence[Tensor]] | None = None,
    reference_point: Tensor | None = None,
    scenes: Sequence[int] = (0, 1, 2),
) -> str:
    """Write tables and figures of an evaluation, and return the table that a person reads first.

    Files: ``episodes.csv`` (see :func:`~morlnav.navigation.evaluation.episode_metrics`), ``summary.csv``, ``fidelity.csv``,
    ``front.csv``, ``table.md``, and, with two or more tuneable objectives, ``trajectories.png`` and ``metrics.png``.

    Args:
        rollouts: batched ``[P, S]``.
        directory: is made if it does not exist; files of an earlier report in it are replaced.
        rewards: names of all ``m`` entries of the reward, static ones first.
        world: where the rollouts were made.
        references: one path ``[L, 2]`` per scene to measure the Fréchet distance to, such as the oracle's; several by
            the name of their objective.
        reference_point: of the hypervolume, ``[m]``; :func:`default_reference` if ``None``.
        scenes: the scenes whose trajectories are drawn, as far as there are so many.

    Returns:
        A Markdown table, a row per preference and one over all, then fidelity, hypervolume and expected utility.

    Raises:
        ValueError: if names, references or the reference point do not fit the rollouts.
    """
    directory = Path(directory)
    frame = episode_metrics(rollouts, rewards, world=world, references=references)
    summary, faithful = summarise(frame), fidelity(frame)
    front = front_table(rollouts, rewards, reference_point)
    table = _table(summary, overall(frame), faithful, front)

    directory.mkdir(parents=True, exist_ok=True)
    tables = {"episodes": frame, "summary": summary, "fidelity": faithful, "front": front}
    for name, content in tables.items():
        content.to_csv(directory / f"{name}.csv", index=False)
    (directory / "table.md").write_text(table + "\n", encoding="utf-8")

    tuneable = rewards[len(rewards) - rollouts.preference.shape[-1] :]
    if len(tuneable) >= 2:
        from morlnav.navigation.record.plots import plot_metrics, plot_trajectories  # loads matplotlib

        shown = [scene for scene in scenes if scene < rollouts.batch_size[1]]
        radii = {} if world is None else {"human_radius": world.human_radius, "robot_radius": world.robot.radius}
        figure = plot_trajectories(rollouts, tuneable, shown, references=references, **radii)
        figure.savefig(directory / "trajectories.png", dpi=150)
        plotted = [name for name in PLOTTED if name in frame]
        plot_metrics(summary, compare_extremes(frame, plotted), plotted).savefig(directory / "metrics.png", dpi=150)
    return table


def _table(summary: pd.DataFrame, total: pd.DataFrame, faithful: pd.DataFrame, front: pd.DataFrame) -> str:
    weights = [name for name in summary if name.startswith("lambda_")]
    shown = _shown(summary)
    last = ["**all**", *[""] * (len(weights) - 1), *_cells(total.iloc[0], shown)]
    lines = [markdown_table(summary, weights), _row(last), ""]
    episodes, scenes = int(total["episodes"].iloc[0]), int(summary["episodes"].iloc[0])
    plural = "s" if len(summary) > 1 else ""
    lines.append(
        f"{episodes} episodes: {len(summary)} preference{plural} in {scenes} scenes. Times count successes only."
    )
    for _, row in faithful.drop_duplicates("objective").iterrows():
        metric = f"{'more' if row['sign'] > 0 else 'less'} {row['metric'].replace('_', ' ')}"
        lines.append(f"Fidelity of {row['objective']} ({metric}): Spearman {row['spearman']:.2f}.")
    lines.append(f"Hypervolume {front['hypervolume'][0]:.4g}, expected utility {front['expected_utility'][0]:.1f}.")
    return "\n".join(lines)


def markdown_table(summary: pd.DataFrame, labels: Sequence[str]) -> str:
    """The metrics of :data:`TABLE` that ``summary`` has, a row per row, as a Markdown table led by ``labels``.

    >>> print(markdown_table(pd.DataFrame({"room": ["hall"], "SR": [100.0]}), ["room"]))
    | room | SR % |
    | --: | --: |
    | hall | 100.0 |
    """
    shown = _shown(summary)
    heading = [name.removeprefix("lambda_") for name in labels] + [_column(name)[0] for name in shown]
    lines = [_row(heading), _row(["--:"] * len(heading))]
    for _, row in summary.iterrows():
        lead = [row[name] if isinstance(row[name], str) else f"{row[name]:.2f}" for name in labels]
        lines.append(_row(lead + _cells(row, shown)))
    return "\n".join(lines)


def _shown(summary: pd.DataFrame) -> list[str]:
    """The columns that a person reads, among them the distance to every objective's own demonstration."""
    own = [frechet_column(name) for name in tuneable_objectives(summary)]
    return [name for name in dict.fromkeys([*TABLE, *own]) if name in summary]


def _column(name: str) -> tuple[str, int]:
    return TABLE.get(name, (f"Fréchet {name.removeprefix('frechet_')} m", 2))


def _cells(row: pd.Series, names: Sequence[str]) -> list[str]:
    return ["–" if pd.isna(row[name]) else f"{row[name]:.{_column(name)[1]}f}" for name in names]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
