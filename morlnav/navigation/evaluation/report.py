"""Everything that an evaluation has to say, written into one directory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
from torch import Tensor

from morlnav.evaluation.front import describe_front, front_table
from morlnav.evaluation.pareto import Scalarisation
from morlnav.navigation.envs import Objective
from morlnav.navigation.evaluation.metrics import by_objective, episode_metrics, frechet_column
from morlnav.navigation.evaluation.possible import (
    EDGE,
    best_utility,
    describe_possible,
    exact_front,
    possible_table,
)
from morlnav.navigation.evaluation.rollout import Rollouts
from morlnav.navigation.evaluation.statistics import compare_extremes, fidelity, overall, summarise, tuneable_objectives
from morlnav.navigation.world import World
from morlnav.record.markdown import markdown_table

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
    "excess": ("excess %", 1),
    "regret": ("regret", 1),
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
    objectives: Mapping[str, Objective] | None = None,
    plans: Mapping[str, Sequence[Tensor]] | None = None,
    scenes: Sequence[int] = (0, 1, 2),
) -> str:
    """Write tables and figures of an evaluation, and return the table that a person reads first.

    Files: ``episodes.csv`` (see :func:`~morlnav.navigation.evaluation.episode_metrics`), ``summary.csv``,
    ``fidelity.csv``, ``front.csv`` (see :func:`~morlnav.evaluation.front_table`), ``table.md``, and, with two or more
    tuneable objectives, ``trajectories.png``, ``metrics.png`` and ``front.png``. Where λ weighs distance and
    efficiency, ``possible.csv`` (see :func:`~morlnav.navigation.evaluation.possible_table`), ``exact_front.csv`` (a row
    per scene and distance) and ``exact_front.png`` set the policy beside what is possible.

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
        objectives: the entries of the reward, to tell what the best known paths would earn.
        plans: the best path ``[L, 2]`` per scene under a learned reward, by the name of its objective; they are known
            paths, too.
        scenes: the scenes whose trajectories are drawn, as far as there are so many.

    Returns:
        A Markdown table, a row per preference and one over all, then fidelity, expected utility and hypervolume.

    Raises:
        ValueError: if names, references or the reference point do not fit the rollouts.
    """
    directory = Path(directory)
    tuneable = rewards[len(rewards) - rollouts.preference.shape[-1] :]
    limits = exact_front(rollouts.scene[0], world) if set(EDGE) <= set(tuneable) else None
    shortest = None if limits is None else limits.length[:, 0]
    frame = episode_metrics(rollouts, rewards, world=world, references=references, shortest=shortest)
    summary, faithful = summarise(frame), fidelity(frame)
    front = front_table(
        rollouts.preference[:, 0],
        rollouts.reward.double().sum(-2),
        rewards,
        _known(reference_point, rewards),
        scalarisation,
    )
    tables = {"episodes": frame, "summary": summary, "fidelity": faithful, "front": front}
    if limits is not None:
        best = None
        if objectives is not None:
            preferences = rollouts.preference[:, 0].cpu()
            planned = {f"{name}, planned": paths for name, paths in (plans or {}).items()}
            known = {**by_objective(references), **planned}
            settings = {"world": world, "references": known, "scalarisation": scalarisation}
            best = best_utility(limits, rollouts.scene[0], preferences, objectives, **settings)
        possible = possible_table(limits, summary, front["utility"], best)
        tables |= {"exact_front": limits.table(), "possible": possible}
    table = _table(overall(frame), **tables)

    directory.mkdir(parents=True, exist_ok=True)
    for name, content in tables.items():
        content.to_csv(directory / f"{name}.csv", index=False)

    if len(tuneable) >= 2:
        from morlnav.evaluation.front_plot import plot_front  # these load matplotlib
        from morlnav.navigation.record.exact_front_plot import plot_exact_front
        from morlnav.navigation.record.plots import plot_metrics, plot_trajectories

        shown = [scene for scene in scenes if scene < rollouts.batch_size[1]]
        radii = {} if world is None else {"human_radius": world.human_radius, "robot_radius": world.robot.radius}
        figure = plot_trajectories(rollouts, tuneable, shown, references=references, **radii)
        figure.savefig(directory / "trajectories.png", dpi=150)
        plotted = [name for name in PLOTTED if name in frame]
        plot_metrics(summary, compare_extremes(frame, plotted), plotted).savefig(directory / "metrics.png", dpi=150)
        plot_front(front).savefig(directory / "front.png", dpi=150)
        if limits is not None:
            plot_exact_front(limits, tables["possible"]).savefig(directory / "exact_front.png", dpi=150)
    (directory / "table.md").write_text(table + "\n", encoding="utf-8")  # last: with it a run has finished
    return table


def _known(reference_point: Tensor | None, rewards: Sequence[str]) -> Tensor | None:
    """The reference point, if it is finite in every entry."""
    if reference_point is None or reference_point.shape == (len(rewards),):
        return reference_point if reference_point is not None and reference_point.isfinite().all() else None
    raise ValueError(
        f"The reference point needs {len(rewards)} numbers, for {', '.join(rewards)}; got {reference_point.tolist()}."
    )


def _table(total: pd.DataFrame, summary: pd.DataFrame, **tables: pd.DataFrame) -> str:
    weights = [name for name in summary if name.startswith("lambda_")]
    if (possible := tables.get("possible")) is not None:
        beside = {"excess": 100 * possible["excess"].where(possible["on_edge"]), "regret": possible.get("regret")}
        beside = {name: values for name, values in beside.items() if values is not None}
        summary = summary.assign(**beside)
        total = total.assign(**{name: values.mean() for name, values in beside.items()})
    shown = _shown(summary)
    rows = [[f"{row[name]:.2f}" for name in weights] + cells(row, shown) for _, row in summary.iterrows()]
    rows.append(["**all**", *[""] * (len(weights) - 1), *cells(total.iloc[0], shown)])
    headings = [name.removeprefix("lambda_") for name in weights] + [column(name)[0] for name in shown]
    return "\n".join([markdown_table(headings, rows), "", *sentences(summary, **tables)])


def sentences(
    summary: pd.DataFrame,
    fidelity: pd.DataFrame,
    front: pd.DataFrame,
    possible: pd.DataFrame | None = None,
    **_: pd.DataFrame,
) -> list[str]:
    """What a report says in words: what was driven, how λ is obeyed, how good the front is, and what is possible.

    Args:
        summary: from :func:`~morlnav.navigation.evaluation.summarise`.
        fidelity: from :func:`~morlnav.navigation.evaluation.fidelity`.
        front: from :func:`~morlnav.navigation.evaluation.front_table`.
        possible: from :func:`~morlnav.navigation.evaluation.possible_table`, where λ weighs distance and efficiency.
    """
    episodes, scenes = int(summary["episodes"].sum()), int(summary["episodes"].iloc[0])
    driven = f"{len(summary)} preference{'s'[: len(summary) > 1]} in {scenes} scene{'s'[: scenes > 1]}"
    lines = [f"{episodes} episodes: {driven}. Times count successes only."]
    for name, rows in fidelity.dropna(subset="spearman").groupby("objective", sort=False):
        first, edges = rows.iloc[0], rows.dropna(subset="edge_spearman")
        metric = f"{'more' if first['sign'] > 0 else 'less'} {first['metric'].replace('_', ' ')}"
        along = [f"{row['edge_spearman']:.2f} against {row['versus']}" for _, row in edges.iterrows()]
        along = f"; {', '.join(along)}" if len(rows) > 1 and along else ""
        lines.append(f"Fidelity of {name} ({metric}): Spearman {first['spearman']:.2f}{along}.")
    lines += [] if possible is None else [describe_possible(possible)]
    return [*lines, describe_front(front)]


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
