"""Figures of a sweep: learning curves, and interquartile means of scores, with intervals over seeds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from morlnav.evaluation.seeds import mean_interval
from morlnav.record.colours import INK, setting_style


def plot_curves(logs: pd.DataFrame, settings: Mapping[str, str], metrics: Mapping[str, str]) -> Figure:
    """Learning curves: means over the seeds of a setting, with 95 % intervals where there are two or more.

    Args:
        logs: from :func:`~morlnav.analysis.load_sweep`.
        settings: the setting of each run, such as from :func:`~morlnav.analysis.load_settings`.
        metrics: what is drawn, with a title for each panel.

    Examples:
        >>> logs = pd.DataFrame({"run": ["0", "0"], "metric": "train/success", "step": [10, 20], "value": [0.1, 0.2]})
        >>> len(plot_curves(logs, {"0": "our"}, {"train/success": "success"}).axes)
        1
    """
    names = list(dict.fromkeys(settings[run] for run in settings if (logs["run"] == run).any()))
    figure = Figure(figsize=(3.8 * len(metrics), 3.2), layout="constrained", facecolor="w")
    panels = figure.subplots(1, len(metrics), squeeze=False)[0]
    for axes, (metric, title), letter in zip(panels, metrics.items(), "abcdefghij", strict=False):
        table = logs[logs["metric"] == metric].pivot(index="step", columns="run", values="value")
        table = table.interpolate("index", limit_area="inside")
        for place, name in enumerate(names):
            seeds = table[[run for run in table if settings[run] == name]].dropna(how="all")
            mean, low, high = np.array([mean_interval(row) for row in seeds.to_numpy()]).reshape(-1, 3).T
            colour, _, line = setting_style(place)
            axes.fill_between(seeds.index, low, high, color=colour, alpha=0.15, lw=0)
            axes.plot(seeds.index, mean, color=colour, ls=line, lw=1.3, label=name)
        if table.min().min() >= 0 and table.max().max() <= 1:
            axes.set_ylim(-0.02, 1.02)  # a share, whose interval may reach further
        axes.set(xlabel="frames", ylabel=title)
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        _tidy(axes, letter)
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False, fontsize=8
    )
    return figure


def plot_scores(table: pd.DataFrame) -> Figure:
    """A panel per score, a line per setting; further right is better.

    Args:
        table: from :func:`~morlnav.evaluation.seeds.aggregate_scores`.

    Examples:
        >>> row = {"score": "success", "setting": "our", "iqm": 0.9, "iqm_low": 0.8, "iqm_high": 1.0}
        >>> plot_scores(pd.DataFrame([row])).axes[0].get_xlabel()
        'success'
    """
    settings, scores = list(table["setting"].unique()), list(table["score"].unique())
    size = (2.7 * len(scores) + 0.5 + 0.09 * max(map(len, settings)), 0.32 * len(settings) + 1.1)
    figure = Figure(figsize=size, layout="constrained", facecolor="w")
    panels = figure.subplots(1, len(scores), sharey=True, squeeze=False)[0]
    for axes, score, letter in zip(panels, scores, "abcdefghij", strict=False):
        for row in table[table["score"] == score].itertuples():
            place = settings.index(row.setting)
            colour, marker, _ = setting_style(place)
            axes.plot(
                [row.iqm_low, row.iqm_high], [place, place], color=colour, lw=5, alpha=0.35, solid_capstyle="butt"
            )
            axes.plot(row.iqm, place, marker, color=colour, ms=6)
        axes.set_xlabel(score)
        _tidy(axes, letter)
    panels[0].set_yticks(range(len(settings)), settings)
    panels[0].set_ylim(len(settings) - 0.5, -0.5)
    return figure


def _tidy(axes: Axes, letter: str) -> None:
    axes.set_title(f"{letter})", loc="left", fontsize=9, color=INK, pad=2)
    axes.xaxis.label.set_fontsize(9)
    axes.yaxis.label.set_fontsize(9)
    axes.tick_params(labelsize=8)
    axes.grid(color="#e9eaec")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
