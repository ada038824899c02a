"""From rows to a table: medians, quartiles and ratios as CSV, Markdown and a plot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from morlnav.benchmarks.timing import Row

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


def markdown(table: pd.DataFrame, titles: Mapping[str, str], notes: Mapping[str, str], machine: str) -> str:
    """The table for people: a section per title, with its notes.

    Args:
        table: from :func:`tabulate`.
        titles: heading of every group that begins a section.
        notes: what a reader must know, by the same groups.
        machine: what it was measured on.
    """
    lines = [
        "# Benchmarks",
        "",
        f"{machine} Medians and quartiles over rounds in which all contenders of a case took turns; the ratio says how "
        "many times better the first row of the case is (the median of the ratios within the rounds).",
    ]
    for group, part in table.groupby("group", sort=False):
        if group in titles:
            lines += ["", f"## {titles[group]}", "", notes[group].replace("\n", " ")]
        lines += ["", "| case | contender | median | quartiles | unit | ratio | note |", TABLE_RULE]
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
    """A panel per group: lines over the size where there are several, else bars; both with quartiles."""
    table = table[table["rounds"] > 0]
    parts = list(table.groupby(["group", "unit"], sort=False))
    figure = Figure(figsize=(13, 3.6 * -(-len(parts) // 2)), layout="constrained")
    panels = figure.subplots(-(-len(parts) // 2), 2, squeeze=False).flatten()
    for axes, ((group, unit), part) in zip(panels, parts, strict=False):
        (_lines if part["size"].nunique() > 1 else _bars)(axes, part)
        axes.set_title(group, loc="left", fontsize=10)
        axes.grid(color="#e9eaec", lw=0.7)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=8)
        (axes.set_ylabel if part["size"].nunique() > 1 else axes.set_xlabel)(unit, fontsize=9)
    for axes in panels[len(parts) :]:
        axes.remove()
    return figure


def _lines(axes: Axes, part: pd.DataFrame) -> None:
    for name, line in part.groupby("name", sort=False):
        spread = [line["median"] - line["q1"], line["q3"] - line["median"]]
        axes.errorbar(line["size"], line["median"], spread, marker="o", ms=4, lw=1.4, label=name)
    axes.set(xscale="log", yscale="log", xlabel="size")
    axes.set_xticks(sorted(part["size"].unique()), [f"{size:g}" for size in sorted(part["size"].unique())])
    axes.minorticks_off()
    axes.legend(fontsize=7, frameon=False)


def _bars(axes: Axes, part: pd.DataFrame) -> None:
    cases = part["case"].nunique() > 1
    labels = [f"{row['name']} ({row['case']})" if cases else row["name"] for _, row in part.iterrows()]
    spread = [part["median"] - part["q1"], part["q3"] - part["median"]]
    axes.barh(labels, part["median"], xerr=spread, color="#2b62d9", height=0.6)
    axes.invert_yaxis()


def write(
    rows: Iterable[Row], directory: Path, titles: Mapping[str, str], notes: Mapping[str, str], machine: str
) -> str:
    """Write ``benchmarks.csv``, ``benchmarks.md`` and ``benchmarks.png``; returns the Markdown."""
    table = tabulate(rows)
    directory.mkdir(parents=True, exist_ok=True)
    table.to_csv(directory / "benchmarks.csv", index=False)
    text = markdown(table, titles, notes, machine)
    (directory / "benchmarks.md").write_text(text, encoding="utf-8")
    if (table["rounds"] > 0).any():
        plot(table).savefig(directory / "benchmarks.png", dpi=130)
    return text
