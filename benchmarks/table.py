"""From rows to a table: medians, quartiles and ratios as CSV and Markdown, and the plot beside them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.plot import plot
from benchmarks.timing import Row
from morlnav.record.markdown import markdown_table

HEADINGS = ("case", "contender", "median", "quartiles", "unit", "ratio", "note")


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
                "ours": row.ours,
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
        lines += ["", f"## {title}", "", notes.replace("\n", " "), ""]
        rows = []
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
            rows.append(cells)
        lines.append(markdown_table(HEADINGS, rows, (":--", ":--", "--:", "--:", ":--", "--:", ":--")))
    return "\n".join(lines) + "\n"


def number(value: float) -> str:
    """Three digits that count.

    >>> number(0.012345), number(7.4), number(123456.0)
    ('0.0123', '7.4', '123,000')
    """
    return f"{float(f'{value:.3g}'):,.12g}"


def write(rows: Iterable[Row], directory: Path, headings: Mapping[str, tuple[str, str]], machine: str) -> str:
    """Write ``benchmarks.csv``, ``benchmarks.md`` and ``benchmarks.png``; returns the Markdown."""
    table = tabulate(rows)
    directory.mkdir(parents=True, exist_ok=True)
    table.to_csv(directory / "benchmarks.csv", index=False)
    text = markdown(table, headings, machine)
    (directory / "benchmarks.md").write_text(text, encoding="utf-8")
    plot(table).savefig(directory / "benchmarks.png", dpi=130)
    return text
