"""Figures of an evaluation: trajectories (Fig. 3) and metrics (Fig. 4) over preferences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import torch
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle

from morlnav.navigation.world.geometry import distance_to_box
from morlnav.record.colours import INK, blend, objective_colours

if TYPE_CHECKING:
    from morlnav.navigation.evaluation.rollout import Rollouts
    from morlnav.navigation.world import Scene

HUMAN, BOX, GOAL = "#e05252", "#c4c7cc", "#2456d6"
LABELS = {
    "navigation_time": "navigation time [s]",
    "frechet": "Fréchet distance [m]",
    "min_obstacle_distance": "min. obstacle distance [m]",
    "min_human_distance": "min. human distance [m]",
    "path_length": "path length [m]",
    "spl": "SPL",
    "personal_space": "personal space kept",
    "mean_jerk": "mean jerk [m/s³]",
}


def tour(num_objectives: int) -> list[tuple[int, int]]:
    """Edges of the preference simplex, joined to a round trip that visits every corner; of three Λ₁, Λ₂, Λ₃ (Fig. 3).

    >>> tour(2), tour(3)
    ([(1, 0)], [(2, 1), (1, 0), (0, 2)])
    """
    n = num_objectives
    return [(1, 0)] if n == 2 else [(i, (i - 1) % n) for i in reversed(range(n))]


def edge_order(preferences: np.ndarray, edge: tuple[int, int]) -> np.ndarray:
    """Indices of the preferences ``[P, n]`` on one edge of the simplex, from its first corner to its second.

    >>> edge_order(np.array([[0.0, 1.0], [1.0, 0.0], [0.5, 0.5]]), (0, 1)).tolist()
    [1, 2, 0]
    """
    on_edge = np.nonzero(np.isclose(preferences[:, edge].sum(1), 1, atol=1e-5))[0]
    return on_edge[np.argsort(preferences[on_edge, edge[1]], kind="stable")]


def plot_trajectories(
    rollouts: Rollouts,
    objectives: Sequence[str] = ("distance", "efficiency"),
    scenes: Sequence[int] = (0, 1, 2),
    *,
    references: Sequence[torch.Tensor] | Mapping[str, Sequence[torch.Tensor]] | None = None,
    human_radius: float = 0.3,
    robot_radius: float = 0.18,
) -> Figure:
    """Trajectories in the style of Fig. 3: a row per edge of the simplex, a column per scene, coloured by λ.

    Args:
        rollouts: batched ``[P, S]``; preferences off the edges are not drawn.
        objectives: names of the ``n`` tuneable objectives.
        scenes: indices of the scenes to show.
        references: a path ``[L, 2]`` per scene of the roll-outs, drawn black, such as the oracle's; of several by the
            name of their objective, those that an edge leads to.
        human_radius: in metres.
        robot_radius: in metres; drawn as a ring around the start.

    Raises:
        ValueError: if the names do not fit the preferences, or a scene is out of range.

    Examples:
        >>> from morlnav.navigation.evaluation import evaluate_policy, evaluation_scenes
        >>> straight = lambda observation, preference: torch.tensor([0.5, 0.0]).expand(len(observation), 2)
        >>> rollouts = evaluate_policy(straight, evaluation_scenes(3), torch.eye(2), max_steps=5)
        >>> len(plot_trajectories(rollouts).axes)
        3
    """
    rollouts = rollouts.cpu()
    if len(objectives) != rollouts.preference.shape[-1] or len(objectives) < 2:
        raise ValueError(f"Preferences have {rollouts.preference.shape[-1]} entries, but got names {list(objectives)}.")
    if not scenes or not all(0 <= scene < rollouts.batch_size[1] for scene in scenes):
        raise ValueError(f"Scenes must be indices below {rollouts.batch_size[1]}, got {list(scenes)}.")
    named = references if isinstance(references, Mapping) else {} if references is None else {"demo": references}
    preferences = rollouts.preference[:, 0].numpy()
    colours, edges = objective_colours(objectives), tour(len(objectives))
    bounds = {scene: scene_bounds(rollouts, scene) for scene in scenes}
    widths = [high[0] - low[0] for low, high in bounds.values()]
    height = max(high[1] - low[1] for low, high in bounds.values())
    scale = 12.4 / sum(widths)  # inches per metre
    figure = Figure(figsize=(14.2, (scale * height + 0.35) * len(edges) + 0.75), layout="constrained", facecolor="w")
    grid = figure.subplots(len(edges), len(scenes), squeeze=False, width_ratios=widths)
    for row, edge in enumerate(edges):
        order = edge_order(preferences, edge)
        share = np.linspace(0, 1, 256)
        colormap = ListedColormap(blend(np.stack([1 - share, share], 1), [colours[i] for i in edge]))
        for column, (axes, scene) in enumerate(zip(grid[row], scenes, strict=True)):
            draw_scene(axes, rollouts.scene[0, scene], human_radius, robot_radius)
            for name, lines in named.items():
                if len(named) == 1 or name in [objectives[i] for i in edge]:
                    axes.plot(*lines[scene].cpu().T, color="k", lw=1.1, zorder=4)
            for index in order:
                path = rollouts.pose[index, scene, : rollouts.steps[index, scene] + 1, :2].numpy()
                colour = colormap(float(preferences[index, edge[1]]))
                axes.plot(*path.T, color=colour, lw=1.7, alpha=0.9, zorder=3, solid_capstyle="round")
                if rollouts.outcome[index, scene] > 1:  # a collision
                    axes.plot(*path[-1], "x", color=INK, ms=6, mew=1.6, zorder=5)
            low, high = bounds[scene]
            middle = (low[1] + high[1]) / 2
            axes.set(xlim=(low[0], high[0]), ylim=(middle - height / 2, middle + height / 2), aspect="equal")
            if row == 0:
                axes.set_title(f"{'ABCDEFGHIJ'[column % 10]}) scene {scene}", fontsize=10, color=INK)
            if row == len(edges) - 1:
                axes.set_xlabel("x [m]", fontsize=9)
        grid[row, 0].set_ylabel(f"$\\Lambda_{{{row + 1}}}$      y [m]", fontsize=9)
        _colour_bar(grid[row, -1], colormap, [objectives[i] for i in edge])
    _scene_legend(figure, bool((rollouts.outcome[:, list(scenes)] > 1).any()), bool(named))
    return figure


def scene_bounds(rollouts: Rollouts, scene: int, margin: float = 0.35) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the part of a scene that is worth seeing: all paths, the human, start and goal."""
    one = rollouts.scene[0, scene]
    points = torch.cat([rollouts.pose[:, scene, :, :2].reshape(-1, 2), one.goal[None], one.human[None]])
    reach = margin + 0.3
    return points.amin(0).numpy() - reach, points.amax(0).numpy() + reach


def draw_scene(axes: Axes, scene: Scene, human_radius: float = 0.3, robot_radius: float = 0.18) -> None:
    """Draw boxes, human, start and goal of one ``scene``, without a batch dimension; lengths are in metres.

    >>> from morlnav.navigation.evaluation import evaluation_scenes
    >>> axes = Figure().subplots()
    >>> draw_scene(axes, evaluation_scenes(1)[0])
    >>> len(axes.patches)  # three boxes, the human and the robot at its start
    5
    """
    near = distance_to_box(scene.goal, scene.boxes) < 100  # others stand in for boxes that a scene does not have
    for x, y, length, width, angle in scene.boxes[near].tolist():
        corner, size = (x - length, y - width), (2 * length, 2 * width)
        style = {"facecolor": BOX, "edgecolor": "#9aa0a8", "lw": 0.8, "zorder": 2}
        axes.add_patch(Rectangle(corner, *size, angle=np.degrees(angle), rotation_point="center", **style))
    axes.add_patch(Circle(scene.human.tolist(), human_radius, facecolor=HUMAN, edgecolor="#a83232", lw=0.8, zorder=2))
    start = scene.start[:2].tolist()
    axes.add_patch(Circle(start, robot_radius, fill=False, edgecolor=INK, lw=0.8, zorder=5))
    axes.plot(*start, "o", color="k", ms=5, zorder=6)
    axes.plot(*scene.goal.tolist(), "*", color=GOAL, ms=14, mec="w", mew=0.8, zorder=6)
    tidy(axes)


def _colour_bar(axes: Axes, colormap: Colormap, names: Sequence[str]) -> None:
    # An inset keeps the height that the axes have after their aspect is made equal.
    bar = axes.figure.colorbar(ScalarMappable(cmap=colormap), cax=axes.inset_axes([1.03, 0, 0.025, 1]))
    bar.set_ticks([0.03, 0.97], labels=list(names), fontsize=9)
    for label, colour in zip(bar.ax.get_yticklabels(), (colormap(0.0), colormap(1.0)), strict=True):
        label.set(color=colour, fontweight="bold")
    bar.ax.tick_params(length=0)
    bar.outline.set_visible(False)


def _scene_legend(figure: Figure, collisions: bool, with_reference: bool) -> None:
    marks = {"lw": 0, "mec": "none"}
    handles = [
        Line2D([], [], marker="o", color="k", ms=6, label="start", **marks),
        Line2D([], [], marker="*", color=GOAL, ms=12, label="goal", **marks),
        Line2D([], [], marker="o", color=HUMAN, ms=10, label="human", **marks),
        Line2D([], [], marker="s", color=BOX, ms=10, label="obstacle", **marks),
    ]
    if collisions:
        handles.append(Line2D([], [], marker="x", color=INK, ms=6, mew=1.6, lw=0, label="collision"))
    if with_reference:
        handles.append(Line2D([], [], color="k", lw=1.1, label="demonstration"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)


def plot_metrics(
    summary: pd.DataFrame,
    comparisons: pd.DataFrame | None = None,
    metrics: Sequence[str] = ("navigation_time", "frechet", "min_obstacle_distance", "min_human_distance"),
    *,
    baseline: pd.DataFrame | None = None,
) -> Figure:
    """Metrics over preferences in the style of Fig. 4: means and the summary's bands above a strip of λ's fractions.

    The horizontal axis walks along the edges of the simplex from corner to corner; preferences off the edges are not
    drawn.

    Args:
        summary: from :func:`~morlnav.navigation.evaluation.summarise`.
        comparisons: from :func:`~morlnav.navigation.evaluation.compare_extremes`; adds significance stars between
            neighbouring corners.
        metrics: columns of ``summary``; those that it lacks are left out.
        baseline: from :func:`~morlnav.navigation.evaluation.overall` for an agent without preferences; a dotted line.

    Raises:
        ValueError: if fewer than two objectives, or none of the metrics, are in the summary.

    Examples:
        >>> summary = pd.DataFrame({"lambda_distance": [1.0, 0.5, 0.0], "lambda_efficiency": [0.0, 0.5, 1.0],
        ...     "navigation_time": [20.0, 19.0, 18.0]})
        >>> summary = summary.assign(navigation_time_low=summary["navigation_time"] - 1,
        ...     navigation_time_high=summary["navigation_time"] + 1)
        >>> len(plot_metrics(summary).axes)  # the metric, and the strip of fractions
        2
    """
    names = [name.removeprefix("lambda_") for name in summary if name.startswith("lambda_")]
    metrics = [name for name in metrics if name in summary]
    if len(names) < 2 or not metrics:
        raise ValueError(f"The summary needs two objectives and one of the metrics; it has {list(summary.columns)}.")
    preferences = summary[[f"lambda_{name}" for name in names]].to_numpy(float)
    edges = [(edge, edge_order(preferences, edge)) for edge in tour(len(names))]
    edges = [(edge, order) for edge, order in edges if len(order) > 1]
    # One step of the walk is one unit wide; neighbouring edges share their corner.
    begins = np.cumsum([0, *(len(order) - 1 for _, order in edges)])
    walks = [(begin + np.arange(len(order)), order) for begin, (_, order) in zip(begins, edges, strict=False)]
    colours = objective_colours(names)

    figure = Figure(figsize=(9.0, 1.75 * len(metrics) + 1.1), layout="constrained", facecolor="w")
    panels = figure.subplots(len(metrics) + 1, 1, sharex=True, height_ratios=[1.0] * len(metrics) + [0.42])
    for axes, metric, letter in zip(panels[:-1], metrics, "abcdefghij", strict=False):
        low, high = summary[f"{metric}_low"].to_numpy(float), summary[f"{metric}_high"].to_numpy(float)
        mean = summary[metric].to_numpy(float)
        for x, order in walks:
            axes.fill_between(x, low[order], high[order], color=INK, alpha=0.13, lw=0)
            axes.plot(x, mean[order], color=INK, lw=1.3, zorder=3)
            axes.scatter(x, mean[order], c=blend(preferences[order], colours), s=26, zorder=4, lw=0)
        axes.set_ylabel(LABELS.get(metric, metric).replace(" [", "\n["), fontsize=9, color=INK)
        axes.set_title(f"{letter})", loc="left", fontsize=9, color=INK, pad=2)
        if baseline is not None and metric in baseline:
            label = "agent without preferences"
            axes.axhline(float(baseline[metric].iloc[0]), color=HUMAN, lw=1.2, ls=(0, (1, 1.5)), label=label)
            figure.legends or figure.legend(loc="outside upper right", frameon=False, fontsize=8)
        tidy(axes)
        if comparisons is not None:
            _draw_stars(axes, comparisons[comparisons["metric"] == metric], begins, [edge for edge, _ in edges], names)

    for x, order in walks:
        bottom = np.zeros(len(x))
        for share, colour in zip(preferences[order].T, colours, strict=True):
            panels[-1].fill_between(x, bottom, bottom + share, color=colour, lw=0, antialiased=False)
            bottom += share
    corners = [edge[0] for edge, _ in edges] + [edge[1] for edge, _ in edges[-1:]]
    panels[-1].set_title(f"{'abcdefghijk'[len(metrics)]})", loc="left", fontsize=9, color=INK, pad=2)
    panels[-1].set(ylim=(0, 1), yticks=[], xlim=(begins[0] - 0.3, begins[-1] + 0.3))
    panels[-1].set_xticks(begins, [names[i] for i in corners], fontsize=9)
    panels[-1].set_ylabel("λ", rotation=0, va="center", labelpad=12, color=INK)
    panels[-1].tick_params(length=0)
    panels[-1].spines[:].set_visible(False)
    for label, corner in zip(panels[-1].get_xticklabels(), corners, strict=True):
        label.set(color=colours[corner], fontweight="bold")
    return figure


def _draw_stars(
    axes: Axes, tests: pd.DataFrame, begins: np.ndarray, edges: Sequence[tuple[int, int]], names: Sequence[str]
) -> None:
    """Brackets above the data from corner to corner, with the significance of the difference."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.24 * (high - low))
    y, tip = high + 0.05 * (high - low), 0.04 * (high - low)
    for edge, left, right in zip(edges, begins, begins[1:], strict=False):
        test = tests[(tests["first"] == names[edge[0]]) & (tests["second"] == names[edge[1]])]
        if len(test) and test["stars"].iloc[0]:
            x = [left + 0.15, left + 0.15, right - 0.15, right - 0.15]
            axes.plot(x, [y - tip, y, y, y - tip], color=INK, lw=0.8)
            axes.text((left + right) / 2, y, test["stars"].iloc[0], ha="center", va="bottom", fontsize=9, color=INK)


def tidy(axes: Axes) -> None:
    """Thin grey frame and grid, small numbers."""
    axes.grid(color="#e9eaec", lw=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, length=0, labelcolor="#666666")
    for side in axes.spines.values():
        side.set_edgecolor("#d5d7da")
