"""From rows to a table: medians, quartiles and ratios as CSV, Markdown and a plot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from morlnav.benchmarks.timing import Row

HEADING = "| case | contender | median | quartiles | unit | ratio | note |"
TABLE_RULE = "| :-- | :-- | --: | --: | :-- | --: | :-- |"


def tabulate(rows: Iterable[Row]) -> pd.DataFrame:
    """One line per row: ``median``, quartiles ``q1`` and ``q3``, and ``ratio``.

    The ratio says how many times better the first contender of the case is: the median of the ratios within every
    round, which a slow round cannot bend. It is missing for rows without values.

    Examples:
        >>> ours, peer = Row("g", "c", "ours", "1/s", [4.0, 6.0, 9.0]), Row("g", "c", "peer", "1/s", [2.0, 2.0, 2.0])
        >>> tabulate([ours, peer])[["median", "ratio"]].to_numpy().tolist()
        [[6.0, 1.0], [2.0, 3.0]]
    """
    first: dict[tuple[str, str, str], Row] = {}
    lines = []
    for row in rows:
        reference = first.setdefault((row.group, row.case, row.unit), row)
        values, ratio = np.array(row.values or [np.nan]), np.nan
        if row.values and reference.values:
            ratios = np.array(reference.values) / np.array(row.values)
            ratio = float(np.median(1 / ratios if row.less_is_better else ratios))
        q1, median, q3 = np.percentile(values, [25, 50, 75])
        lines.append(
            {
                "group": row.group,
                "case": row.case,
                "name": row.name,
                "unit": row.unit,
                "median": median,
                "q1": q1,
                "q3": q3,
                "rounds": len(row.values),
                "ratio": ratio,
                "size": row.size,
                "note": row.note,
            }
        )
    return pd.DataFrame(lines)


def markdown(table: pd.DataFrame, headings: Mapping[str, tuple[str, str]], machine: str) -> str:
    """The table for people, a section per group.

    Args:
        table: from :func:`tabulate`.
        headings: title of every group, and what a reader must know.
        machine: what it was measured on.
    """
    lines = [
        f"{machine} Medians and quartiles over rounds in which all contenders of a case took turns; the ratio says how "
        "many times better the first row of the case is (the median of the ratios within the rounds).",
    ]
    for group, part in table.groupby("group", sort=False):
        title, notes = headings[group]
        lines += ["", f"## {title}", "", notes.replace("\n", " "), "", HEADING, TABLE_RULE]
        for _, row in part.iterrows():
            measured = row["rounds"] > 0
            quartiles = f"{number(row['q1'])} … {number(row['q3'])}" if row["rounds"] > 1 else "–"
            cells = [
                row["case"],
                row["name"],
                number(row["median"]) if measured else "–",
                quartiles,
                row["unit"],
                f"{row['ratio']:.2f}" if np.isfinite(row["ratio"]) else "–",
                row["note"],
            ]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def number(value: float) -> str:
    """Three digits that count.

    >>> number(0.012345), number(7.4), number(123456.0)
    ('0.0123', '7.4', '123,000')
    """
    return f"{float(f'{value:.3g}'):,.12g}"


def plot(table: pd.DataFrame) -> Figure:
    """A panel per group, unit and growing thing: lines over the size, or bars where there is one; with quartiles."""
    measured = table[table["rounds"] > 0]
    parts = list(measured.groupby(["group", "unit", measured["case"].map(_growing)], sort=False))
    rows = max(1, math.ceil(len(parts) / 2))
    figure = Figure(figsize=(13, 3.6 * rows), layout="constrained")
    panels = figure.subplots(rows, 2, squeeze=False).flatten()
    for axes, ((group, unit, _), part) in zip(panels, parts, strict=False):
        draw = _lines if part["size"].nunique() > 1 else _bars
        draw(axes, part)
        axes.set_title(f"{group}: {unit}", loc="left", fontsize=10)
        axes.grid(color="#e9eaec", lw=0.7)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=8)
    for axes in panels[len(parts) :]:
        axes.remove()
    return figure


def _lines(axes: Axes, part: pd.DataFrame) -> None:
    for name, line in part.groupby("name", sort=False):
        axes.errorbar(line["size"], line["median"], _spread(line), marker="o", ms=4, lw=1.4, label=name)
    sizes = sorted(part["size"].unique())
    axes.set(xscale="log", yscale="log", xlabel=_growing(part["case"].iloc[0]))
    axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
    axes.minorticks_off()
    axes.legend(fontsize=7, frameon=False)


def _growing(case: str) -> str:
    """What the number of a case counts: ``boxes`` of ``10 boxes``."""
    return case.strip("0123456789 ")


def _bars(axes: Axes, part: pd.DataFrame) -> None:
    several = part["case"].nunique() > 1
    labels = [f"{row['name']}, {row['case']}" if several else row["name"] for _, row in part.iterrows()]
    axes.barh(labels, part["median"], xerr=_spread(part), color="#2b62d9", height=0.6)
    axes.invert_yaxis()


def _spread(part: pd.DataFrame) -> list[pd.Series]:
    return [part["median"] - part["q1"], part["q3"] - part["median"]]


def write(rows: Iterable[Row], directory: Path, headings: Mapping[str, tuple[str, str]], machine: str) -> str:
    """Write ``benchmarks.csv``, ``benchmarks.md`` and ``benchmarks.png``; returns the Markdown."""
    table = tabulate(rows)
    directory.mkdir(parents=True, exist_ok=True)
    table.to_csv(directory / "benchmarks.csv", index=False)
    text = markdown(table, headings, machine)
    (directory / "benchmarks.md").write_text(text, encoding="utf-8")
    plot(table).savefig(directory / "benchmarks.png", dpi=130)
    return text
