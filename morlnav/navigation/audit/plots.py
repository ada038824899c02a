"""Figures of a reward's audit: margins over alternatives, degradation with noise, and the paths it likes best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure

from morlnav.navigation.record.plots import HUMAN, draw_scene, tidy
from morlnav.record.colours import COLOURS, INK

if TYPE_CHECKING:
    from morlnav.navigation.evaluation.planner import PlannedPath


def plot_margins(behaviours: pd.DataFrame) -> Figure:
    """Mean margin of the target over each alternative, with its interval and what is required of it.

    Args:
        behaviours: the frame of an :class:`~morlnav.navigation.audit.Audit`.

    Examples:
        >>> rows = {"behaviour": ["target", "idle"], "margin": [np.nan, 2000.0], "margin_low": [np.nan, 1900.0],
        ...     "margin_high": [np.nan, 2100.0], "required": [np.nan, 500.0]}
        >>> len(plot_margins(pd.DataFrame(rows)).axes)
        1
    """
    rows = behaviours[behaviours["behaviour"] != "target"].iloc[::-1]
    margin, required = rows["margin"].to_numpy(float), rows["required"].to_numpy(float)
    ends = np.stack([margin - rows["margin_low"].to_numpy(float), rows["margin_high"].to_numpy(float) - margin])
    figure = Figure(figsize=(7.2, 0.32 * len(rows) + 1.1), layout="constrained", facecolor="w")
    axes = figure.subplots()
    y = np.arange(len(rows))
    colours = [COLOURS["demo"] if enough else HUMAN for enough in margin > required]
    axes.barh(y, margin, color=colours, height=0.62, zorder=2)
    axes.errorbar(
        margin, y, xerr=np.nan_to_num(ends).clip(0), fmt="none", ecolor=INK, elinewidth=1, capsize=2, zorder=4
    )
    axes.plot(required, y, "|", color=INK, ms=11, mew=1.6, zorder=3, label="required")
    axes.axvline(0, color=INK, lw=0.8)
    axes.set_xscale("symlog", linthresh=100, linscale=1.5)
    axes.set_yticks(y, rows["behaviour"])
    axes.set_xlabel("margin of the target's return over the alternative's", fontsize=9)
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    tidy(axes)
    return figure


def plot_noise(noise: pd.DataFrame, calibration: pd.DataFrame) -> Figure:
    """Mean reward and baseline return over ``ε`` (Fig. 2a), and how often the reward's preferences are right.

    Args:
        noise: the frame of an :class:`~morlnav.navigation.audit.Audit`.
        calibration: the same.
    """
    figure = Figure(figsize=(9.4, 3.1), layout="constrained", facecolor="w")
    reward, baseline, pairs = figure.subplots(1, 3)
    epsilon = noise["epsilon"].to_numpy(float)
    reward.fill_between(
        epsilon, noise["mean_reward_low"], noise["mean_reward_high"], color=COLOURS["demo"], alpha=0.2, lw=0
    )
    reward.plot(epsilon, noise["mean_reward"], "o-", color=COLOURS["demo"], ms=4)
    reward.set(ylim=(0, 1.02), xlabel="noise ε", ylabel="mean reward")
    baseline.plot(epsilon, noise["baseline"], "o-", color=COLOURS["distance"], ms=4)
    baseline.set(xlabel="noise ε", ylabel="normalised baseline return")
    pairs.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=(0, (1, 1.5)))
    pairs.plot(calibration["predicted"], calibration["empirical"], "o-", color=COLOURS["efficiency"], ms=4)
    pairs.set(xlim=(0, 1), ylim=(0, 1), xlabel="predicted chance of less noise", ylabel="share with less noise")
    for axes in (reward, baseline, pairs):
        tidy(axes)
    return figure


def plot_plans(
    planned: Sequence[PlannedPath],
    references: Sequence[torch.Tensor],
    *,
    human_radius: float = 0.3,
    robot_radius: float = 0.18,
) -> Figure:
    """The path that a reward likes best in each scene, over the reward that the best motion earns at every place.

    Args:
        planned: from :class:`~morlnav.navigation.evaluation.PathPlanner`.
        references: the target's path ``[L, 2]`` in each of these scenes, drawn dotted.
        human_radius: in metres.
        robot_radius: in metres; drawn as a ring around the start.

    Raises:
        ValueError: if nothing is planned.
    """
    if not planned:
        raise ValueError("There is no planned path to draw.")
    figure = Figure(figsize=(8.4, 3.2 * len(planned)), layout="constrained", facecolor="w")
    for axes, plan, reference in zip(
        figure.subplots(len(planned), 1, squeeze=False)[:, 0], planned, references, strict=True
    ):
        x, y = plan.grid.unbind(-1)
        image = axes.pcolormesh(x, y, plan.reward_map, cmap="Greens", vmin=0, vmax=1, shading="nearest", zorder=0)
        image.set_rasterized(True)
        draw_scene(axes, plan.scene, human_radius, robot_radius)
        axes.plot(*reference.cpu().T, color=INK, lw=1.2, ls=(0, (1, 1.5)), zorder=6, label="demonstration")
        axes.plot(*plan.path.T, color=COLOURS["distance"], lw=1.8, zorder=5, label="optimum of the reward")
        axes.grid(False)
        low, high = plan.grid.amin((0, 1)), plan.grid.amax((0, 1))
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
        figure.colorbar(image, ax=axes, label="reward of the best motion", shrink=0.8)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure
