"""The figure of what is possible: a policy's points beside the exact front of its scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from morlnav.record.colours import INK, blend, objective_colours, setting_style

if TYPE_CHECKING:
    from morlnav.navigation.evaluation.possible import ExactFront

REACHED = ("front_share", "mean_excess")


def plot_exact_front(front: ExactFront, table: pd.DataFrame) -> Figure:
    """Distance to the human against time, means over scenes: the front, every preference, and the area they dominate.

    Right and down is better. The band holds the front of the middle 80 % of the scenes; the line from a preference
    between distance and efficiency down to the front is its excess of time.

    Args:
        front: of the scenes.
        table: from :func:`~morlnav.navigation.evaluation.possible.possible_table`.

    Examples:
        >>> import torch
        >>> from morlnav.navigation.evaluation.possible import ExactFront
        >>> front = ExactFront(torch.tensor([0.48, 2.0]), torch.tensor([[10.0, 11.0]]), [])
        >>> table = pd.DataFrame({"lambda_distance": [1.0, 0.0], "lambda_efficiency": [0.0, 1.0],
        ...     "min_human_distance": [1.5, 0.6], "time_ratio": [1.1, 1.02], "on_edge": True})
        >>> plot_exact_front(front, table).axes[0].get_ylabel()
        'time over the shortest path'
    """
    figure, axes = _draw_front(front)
    distance = front.distance.numpy()
    edge = table.loc[table["on_edge"], ["min_human_distance", "time_ratio"]].dropna()
    grid = np.linspace(distance[0], distance[-1], 500)
    reached = front.reach(edge["min_human_distance"].to_numpy(), edge["time_ratio"].to_numpy(), grid)
    most = front.reach(np.array([]), np.array([]), grid)
    axes.fill_between(grid, reached, most, where=reached < most, color="#2456d6", alpha=0.12, lw=0, step="mid")
    kept, times = edge["min_human_distance"].to_numpy(), edge["time_ratio"].to_numpy()
    axes.vlines(kept, front.at(kept), times, color=INK, lw=0.7, alpha=0.5)
    names = [name for name in table if name.startswith("lambda_")]
    colours = objective_colours([name.removeprefix("lambda_") for name in names])
    axes.scatter(
        table["min_human_distance"],
        table["time_ratio"],
        c=blend(table[names].to_numpy(), colours),
        s=np.where(table["on_edge"], 42, 16),
        zorder=3,
    )
    for name, colour in zip(names, colours, strict=True):
        axes.scatter([], [], color=colour, label=f"all weight on {name.removeprefix('lambda_')}")
    figure.legend(loc="outside upper center", ncols=2, frameon=False, fontsize=8)
    return figure


def plot_reached_fronts(front: ExactFront, tables: Mapping[str, Sequence[pd.DataFrame]]) -> Figure:
    """The same for the settings of a sweep: between distance and efficiency, means over seeds; each share and excess.

    Args:
        front: of the scenes.
        tables: by setting, a :func:`~morlnav.navigation.evaluation.possible_table` of each seed.

    Examples:
        >>> import torch
        >>> from morlnav.navigation.evaluation.possible import ExactFront
        >>> front = ExactFront(torch.tensor([0.48, 2.0]), torch.tensor([[10.0, 11.0]]), [])
        >>> table = pd.DataFrame({"min_human_distance": [1.5, 0.6], "time_ratio": [1.1, 1.02], "on_edge": True})
        >>> figure = plot_reached_fronts(front, {"our": [table.assign(front_share=0.4, mean_excess=0.02)]})
        >>> figure.legends[0].get_texts()[-1].get_text()
        'our: 40 %, +2.0 %'
    """
    figure, axes = _draw_front(front)
    for place, (name, seeds) in enumerate(tables.items()):
        colour, marker, line_style = setting_style(place)
        points = [table[["min_human_distance", "time_ratio"]].where(table["on_edge"]) for table in seeds]
        line = (sum(points) / len(points)).dropna().sort_values("min_human_distance")
        share, excess = (100 * np.mean([table[key].iloc[0] for table in seeds]) for key in REACHED)
        style = {"color": colour, "marker": marker, "ls": line_style, "ms": 5, "lw": 1.0, "alpha": 0.9}
        axes.plot(*line.to_numpy().T, label=f"{name}: {share:.0f} %, {excess:+.1f} %", **style)
    columns = max(1, 90 // (max(map(len, tables)) + 14))  # as many as the width has room for
    figure.legend(loc="outside upper center", ncols=columns, frameon=False, fontsize=8)
    return figure


def _draw_front(front: ExactFront) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(6.4, 4.4), layout="constrained", facecolor="w")
    axes = figure.subplots()
    distance = front.distance.numpy()
    ratio = front.ratio.numpy()
    low, high = np.nanquantile(np.where(np.isfinite(ratio), ratio, np.nan), [0.1, 0.9], axis=0)
    axes.fill_between(distance, low, high, color=INK, alpha=0.08, lw=0)
    axes.plot(distance, front.time_ratio, color=INK, lw=1.4, label="exact front (and of 80 % of the scenes)")
    axes.set_xlabel("least distance to the human [m]")
    axes.set_ylabel("time over the shortest path")
    axes.grid(color="#e9eaec")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes
