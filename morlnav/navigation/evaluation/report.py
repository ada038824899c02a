"""Everything that an evaluation has to say, written into one directory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
from torch import Tensor

from morlnav.evaluation.front import describe_front, front_table
from morlnav.evaluation.pareto import Scalarisation
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


def write_report(
    rollouts: Rollouts,
    directory: str | Path,
    rewards: Sequence[str] = ("baseline", "distance", "efficiency"),
    *,
    world: World | None = None,
    references: Sequence[Tensor] | Mapping[str, Sequence[Tensor]] | None = None,
    reference_point: Tensor | None = None,
    scalarisation: Scalarisation | None = None,
    scenes: Sequence[int] = (0, 1, 2),
) -> str:
    """Write tables and figures of an evaluation, and return the table that a person reads first.

    Files: ``episodes.csv`` (see :func:`~morlnav.navigation.evaluation.episode_metrics`), ``summary.csv``,
    ``fidelity.csv``, ``front.csv`` (see :func:`~morlnav.evaluation.front_table`), ``table.md``, and, with two or more
    tuneable objectives, ``trajectories.png``, ``metrics.png`` and ``front.png``.

    Args:
        rollouts: batched ``[P, S]``.
        directory: is made if it does not exist; files of an earlier report in it are replaced.
        rewards: names of all ``m`` entries of the reward, static ones first.
        world: where the rollouts were made.
        references: one path ``[L, 2]`` per scene to measure the Fréchet distance to, such as the oracle's; several by
            the name of their objective.
        reference_point: of the hypervolume, ``[m]``, such as :func:`~morlnav.evaluation.reference_from_bounds` gives;
            without it, or where an entry is not finite, there is no hypervolume.
        scalarisation: weighs the returns in the expected utility, as the loss does; ``None`` takes ``[1, λ]``.
        scenes: the scenes whose trajectories are drawn, as far as there are so many.

    Returns:
        A Markdown table, a row per preference and one over all, then fidelity, expected utility and hypervolume.

    Raises:
        ValueError: if names, references or the reference point do not fit the rollouts.
    """
    directory = Path(directory)
    frame = episode_metrics(rollouts, rewards, world=world, references=references)
    summary, faithful = summarise(frame), fidelity(frame)
    front = front_table(
        rollouts.preference[:, 0],
        rollouts.reward.double().sum(-2),
        rewards,
        _known(reference_point, rewards),
        scalarisation,
    )
    table = _table(summary, overall(frame), faithful, front)

    directory.mkdir(parents=True, exist_ok=True)
    tables = {"episodes": frame, "summary": summary, "fidelity": faithful, "front": front}
    for name, content in tables.items():
        content.to_csv(directory / f"{name}.csv", index=False)
    (directory / "table.md").write_text(table + "\n", encoding="utf-8")

    tuneable = rewards[len(rewards) - rollouts.preference.shape[-1] :]
    if len(tuneable) >= 2:
        from morlnav.evaluation.front_plot import plot_front  # these load matplotlib
        from morlnav.navigation.record.plots import plot_metrics, plot_trajectories

        shown = [scene for scene in scenes if scene < rollouts.batch_size[1]]
        radii = {} if world is None else {"human_radius": world.human_radius, "robot_radius": world.robot.radius}
        figure = plot_trajectories(rollouts, tuneable, shown, references=references, **radii)
        figure.savefig(directory / "trajectories.png", dpi=150)
        plotted = [name for name in PLOTTED if name in frame]
        plot_metrics(summary, compare_extremes(frame, plotted), plotted).savefig(directory / "metrics.png", dpi=150)
        plot_front(front).savefig(directory / "front.png", dpi=150)
    return table


def _known(reference_point: Tensor | None, rewards: Sequence[str]) -> Tensor | None:
    """The reference point, if it is finite in every entry."""
    if reference_point is None or reference_point.shape == (len(rewards),):
        return reference_point if reference_point is not None and reference_point.isfinite().all() else None
    raise ValueError(
        f"The reference point needs {len(rewards)} numbers, for {', '.join(rewards)}; got {reference_point.tolist()}."
    )


def _table(summary: pd.DataFrame, total: pd.DataFrame, faithful: pd.DataFrame, front: pd.DataFrame) -> str:
    weights = [name for name in summary if name.startswith("lambda_")]
    shown = _shown(summary)
    last = ["**all**", *[""] * (len(weights) - 1), *cells(total.iloc[0], shown)]
    lines = [markdown_table(summary, weights), _row(last), ""]
    return "\n".join([*lines, *sentences(summary, faithful, front)])


def sentences(summary: pd.DataFrame, faithful: pd.DataFrame, front: pd.DataFrame) -> list[str]:
    """What a report says in words: what was driven, how λ is obeyed, and how good the front is.

    Args:
        summary: from :func:`~morlnav.navigation.evaluation.summarise`.
        faithful: from :func:`~morlnav.navigation.evaluation.fidelity`.
        front: from :func:`~morlnav.navigation.evaluation.front_table`.
    """
    episodes, scenes = int(summary["episodes"].sum()), int(summary["episodes"].iloc[0])
    plural = "s" if len(summary) > 1 else ""
    lines = [f"{episodes} episodes: {len(summary)} preference{plural} in {scenes} scenes. Times count successes only."]
    for _, row in faithful.dropna(subset="spearman").drop_duplicates("objective").iterrows():
        metric = f"{'more' if row['sign'] > 0 else 'less'} {row['metric'].replace('_', ' ')}"
        lines.append(f"Fidelity of {row['objective']} ({metric}): Spearman {row['spearman']:.2f}.")
    return [*lines, describe_front(front)]


def markdown_table(summary: pd.DataFrame, labels: Sequence[str]) -> str:
    """The metrics of :data:`TABLE` that ``summary`` has, a row per row, as a Markdown table led by ``labels``.

    >>> print(markdown_table(pd.DataFrame({"room": ["hall"], "SR": [100.0]}), ["room"]))
    | room | SR % |
    | --: | --: |
    | hall | 100.0 |
    """
    shown = _shown(summary)
    heading = [name.removeprefix("lambda_") for name in labels] + [column(name)[0] for name in shown]
    lines = [_row(heading), _row(["--:"] * len(heading))]
    for _, row in summary.iterrows():
        lead = [row[name] if isinstance(row[name], str) else f"{row[name]:.2f}" for name in labels]
        lines.append(_row(lead + cells(row, shown)))
    return "\n".join(lines)


def _shown(summary: pd.DataFrame) -> list[str]:
    """The columns that a person reads, among them the distance to every objective's own demonstration."""
    own = [frechet_column(name) for name in tuneable_objectives(summary)]
    return [name for name in dict.fromkeys([*TABLE, *own]) if name in summary]


def column(name: str) -> tuple[str, int]:
    """Heading and digits of a metric in a readable table."""
    return TABLE.get(name, (f"Fréchet {name.removeprefix('frechet_')} m", 2))


def cells(row: pd.Series, names: Sequence[str]) -> list[str]:
    """The metrics of a row as they are read; a dash for what no episode gave."""
    return ["–" if pd.isna(row[name]) else f"{row[name]:.{column(name)[1]}f}" for name in names]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
