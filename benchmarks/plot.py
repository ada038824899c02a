"""The picture of a table of measurements: morlnav blue and solid, all others grey or dashed."""

from __future__ import annotations

import math
from itertools import cycle

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

OURS = ("#2b62d9", "#10a5a0", "#7a4fd0", "#12306e")
OTHERS = ("#8a8f98", "#c28f2c", "#b5485d", "#5b6068", "#c9b79c")
PANEL = 6.5, 3.6  # inches


def plot(table: pd.DataFrame) -> Figure:
    """A panel per group, case and unit: lines over the size, or bars where there is one; with quartiles.

    Args:
        table: from :func:`benchmarks.table.tabulate`.
    """
    measured = table[table["rounds"] > 0]
    measured = measured.assign(panel=[_panel(row) for row in measured.itertuples()])
    parts = list(measured.groupby(["panel", "unit"], sort=False))
    rows = max(1, math.ceil(len(parts) / 2))
    figure = Figure(figsize=(2 * PANEL[0], PANEL[1] * rows), layout="constrained")
    panels = figure.subplots(rows, 2, squeeze=False).flatten()
    for axes, ((panel, unit), part) in zip(panels, parts, strict=False):
        (_lines if part["size"].nunique() > 1 else _bars)(axes, part)
        axes.set_title(f"{panel}, in {unit}", loc="left", fontsize=10)
        axes.grid(color="#e9eaec", lw=0.7)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=8)
    for axes in panels[len(parts) :]:
        axes.remove()
    hands = [Patch(color=OURS[0], label="morlnav; solid lines"), Patch(color=OTHERS[0], label="others; dashed lines")]
    figure.legend(handles=hands, loc="outside upper right", ncols=2, fontsize=8, frameon=False)
    return figure


def _panel(row: object) -> str:
    """``growth: boxes`` of ten boxes: what belongs together whatever its number."""
    return f"{row.group}: {growing(row.case, row.size)}"


def growing(case: str, size: float | None) -> str:
    """What the number of a case counts.

    >>> growing("10 boxes", 10), growing("batch 64, cuda", 64.0), growing("4×256, 4 objectives", None)
    ('boxes', 'batch, cuda', '4×256, 4 objectives')
    """
    if size is None or math.isnan(size):
        return case
    return f" {case}".replace(f" {size:g}", "").strip()


def _lines(axes: Axes, part: pd.DataFrame) -> None:
    colours = {True: cycle(OURS), False: cycle(OTHERS)}
    for (name, ours), line in part.groupby(["name", "ours"], sort=False):
        style = {"color": next(colours[ours]), "ls": "-" if ours else "--"}
        axes.errorbar(line["size"], line["median"], _spread(line), marker="o", ms=4, lw=1.4, label=name, **style)
    sizes = sorted(part["size"].unique())
    axes.set(xscale="log", xlabel=growing(part["case"].iloc[0], part["size"].iloc[0]))
    axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
    axes.minorticks_off()
    if part["median"].max() > 10 * part["median"].min():
        axes.set_yscale("log")
    else:
        axes.set_ylim(0, 1.1 * part["q3"].max())
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1), fontsize=7, frameon=False)  # beside the lines


def _bars(axes: Axes, part: pd.DataFrame) -> None:
    colours = [OURS[0] if ours else OTHERS[0] for ours in part["ours"]]
    axes.barh(part["name"], part["median"], xerr=_spread(part), color=colours, height=0.6)
    axes.invert_yaxis()


def _spread(part: pd.DataFrame) -> list[pd.Series]:
    return [part["median"] - part["q1"], part["q3"] - part["median"]]
