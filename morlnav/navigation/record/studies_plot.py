"""What a clone is worth, over noise and over the number of demonstrations (Fig. 2)."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from morlnav.navigation.record.plots import tidy
from morlnav.record.colours import COLOURS, INK


def plot_studies(*tables: pd.DataFrame) -> Figure:
    """What a clone is worth over noise and over the number of demonstrations, in the style of Fig. 2.

    Args:
        tables: of ``morlnav-clone``, a panel each: ``epsilon`` or ``demonstrations`` first, then ``baseline`` with its
            interval, and ``demonstrator``.

    Examples:
        >>> row = {"epsilon": 0.0, "baseline": 0.9, "baseline_low": 0.8, "baseline_high": 1.0, "demonstrator": 0.95}
        >>> len(plot_studies(pd.DataFrame([row])).axes)
        1
    """
    figure = Figure(figsize=(4.4 * len(tables), 3.0), layout="constrained", facecolor="w")
    for axes, table, letter in zip(figure.subplots(1, len(tables), squeeze=False)[0], tables, "ab", strict=False):
        name, colour = table.columns[0], COLOURS["demo"]
        axes.axhline(table["demonstrator"].iloc[0], color=INK, lw=1, ls=(0, (1, 1.5)), label="demonstrator")
        axes.fill_between(table[name], table["baseline_low"], table["baseline_high"], color=colour, alpha=0.2, lw=0)
        axes.plot(table[name], table["baseline"], "o-", color=colour, ms=4, label="clone")
        label = {"epsilon": "noise ε", "demonstrations": "demonstrations $N_D$"}[name]
        scale = "log" if name == "demonstrations" else "linear"
        axes.set(xlabel=label, ylabel="normalised baseline return", xscale=scale)
        axes.set_title(f"{letter})" if len(tables) > 1 else "", loc="left", fontsize=9, color=INK, pad=2)
        axes.legend(frameon=False, fontsize=8)
        tidy(axes)
    return figure
