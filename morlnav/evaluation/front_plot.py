"""The figure of a front: what a policy earns under each preference, by pairs of objectives."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pandas as pd
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from morlnav.evaluation.pareto import pareto_mask
from morlnav.record.colours import INK, blend, objective_colours


def plot_front(table: pd.DataFrame) -> Figure:
    """A panel per pair of the objectives that λ weighs (of all, if it weighs one): mean returns, coloured by λ.

    The line of a panel joins the points that are not dominated in its two objectives; dark rings are not dominated in
    all of them. Up and right is better.

    Args:
        table: from :func:`~morlnav.evaluation.front_table`, of any task.

    Raises:
        ValueError: if there are fewer than two objectives.

    Examples:
        >>> from morlnav.evaluation import front_table
        >>> points = torch.tensor([[2.0, 1.0], [1.0, 3.0]])
        >>> len(plot_front(front_table(torch.eye(2), points, ["speed", "comfort"])).axes)
        1
    """
    weighed = [name.removeprefix("lambda_") for name in table if name.startswith("lambda_")]
    rewards = [name.removeprefix("return_") for name in table if name.startswith("return_")]
    shown = weighed if len(weighed) > 1 else rewards
    if len(shown) < 2:
        raise ValueError(f"A front needs two objectives or more, got {', '.join(shown) or 'none'}.")
    pairs = list(combinations(shown, 2))
    width = min(3, len(pairs))
    height = -(-len(pairs) // width)
    figure = Figure(figsize=(max(4.2 * width, 5.2), 3.6 * height + 0.5), layout="constrained", facecolor="w")
    panels = figure.subplots(height, width, squeeze=False).ravel()
    corners = objective_colours(weighed)
    colours = blend(table[[f"lambda_{name}" for name in weighed]].to_numpy(), corners)
    for axes, pair in zip(panels, pairs, strict=False):
        _panel(axes, table, pair, colours)
    for axes in panels[len(pairs) :]:
        axes.remove()
    marks = {"marker": "o", "lw": 0, "ms": 6}
    handles = [
        Line2D([], [], color=colour, mec="none", label=f"all weight on {name}", **marks)
        for name, colour in zip(weighed, corners, strict=True)
    ]
    handles.append(Line2D([], [], mfc="none", mec=INK, label="not dominated", **marks))
    columns = len(handles) if width > 1 else 2
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, frameon=False, fontsize=9)
    return figure


def _panel(axes: Axes, table: pd.DataFrame, pair: tuple[str, str], colours: np.ndarray) -> None:
    x, y = (table[f"return_{name}"] for name in pair)
    best = pareto_mask(torch.tensor(table[[f"return_{name}" for name in pair]].to_numpy(float))).numpy()
    line = table[best].sort_values(f"return_{pair[0]}")
    axes.plot(line[f"return_{pair[0]}"], line[f"return_{pair[1]}"], color=INK, lw=0.9, alpha=0.6, zorder=1)
    rings = [INK if flag else "none" for flag in table["non_dominated"]]
    axes.scatter(x, y, c=colours, s=40, edgecolors=rings, lw=0.9, zorder=2)
    axes.set_xlabel(f"return: {pair[0]}", fontsize=9)
    axes.set_ylabel(f"return: {pair[1]}", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(color="#e9eaec")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
