"""What the end of a training or an evaluation says in a terminal: few rows, the columns that apply, aligned."""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from morlnav.navigation.evaluation.metrics import frechet_column
from morlnav.navigation.evaluation.report import cells, column
from morlnav.record.console import make_console, make_table, print_first_that_fits

COLUMNS = (
    *("SR", "CR", "TR", "navigation_time", "min_human_distance", "frechet", "human_on_right", "spl"),
    *("personal_space", "min_obstacle_distance", "time_ratio", "frechet_free"),
)
"""In the order in which they are shown, as far as there is room."""

OF_DEMO = ("frechet", "frechet_free", "human_on_right")
"""Columns that say how near a path is to the demonstration of the objective ``demo``."""


def print_summary(
    summary: pd.DataFrame,
    total: pd.DataFrame | None = None,
    *,
    label: str | None = None,
    demonstrated: Collection[str] = (),
    console: Console | None = None,
) -> None:
    """Print the corners of the preference simplex (all rows, if there are none) and the row over all.

    Args:
        summary: from :func:`~morlnav.navigation.evaluation.summarise`.
        total: from :func:`~morlnav.navigation.evaluation.overall`.
        label: the column that names the rows; by default they are the objectives that have all weight.
        demonstrated: objectives that come from demonstrations; distances to others are not shown.
        console: where to print; the standard output by default. Columns that its width has no room for are left out.

    Examples:
        >>> summary = pd.DataFrame({"lambda_distance": [1.0, 0.5, 0.0], "lambda_efficiency": [0.0, 0.5, 1.0],
        ...     "SR": [100.0, 99.0, 98.0], "navigation_time": [20.0, 18.0, 16.0]})
        >>> total = summary[["SR", "navigation_time"]].mean().to_frame().T
        >>> print_summary(summary, total)  # doctest: +NORMALIZE_WHITESPACE
        <BLANKLINE>
         all weight on    SR %   time s
        ────────────────────────────────
         distance        100.0     20.0
         efficiency       98.0     16.0
         all 3            99.0     18.0
        <BLANKLINE>
    """
    console = console or make_console()
    rows = [*_rows(summary, label)]
    if total is not None:
        rows.append((f"all {len(summary)}", total.iloc[0]))
    names = _applicable(summary, demonstrated)
    lines = [[name, *cells(row, names)] for name, row in rows]
    headings = [column(name)[0] for name in names]
    counts = range(len(names), -1, -1)
    print_first_that_fits((make_table(headings[:n], lines, label or "all weight on") for n in counts), console)


def _rows(summary: pd.DataFrame, label: str | None) -> list[tuple[str, pd.Series]]:
    if label is not None:
        return [(row[label], row) for _, row in summary.iterrows()]
    weights = [name for name in summary if name.startswith("lambda_")]
    corners = [
        (name.removeprefix("lambda_"), summary[np.isclose(summary[name], 1, atol=1e-5)].iloc[0])
        for name in weights
        if np.isclose(summary[name], 1, atol=1e-5).any()
    ]
    others = [(", ".join(f"{row[name]:g}" for name in weights), row) for _, row in summary.iterrows()]
    return corners or others


def _applicable(summary: pd.DataFrame, demonstrated: Collection[str]) -> list[str]:
    names = [name for name in COLUMNS if name not in OF_DEMO or "demo" in demonstrated]
    own = [frechet_column(name) for name in demonstrated if name != "demo"]
    return [name for name in [*names[:5], *own, *names[5:]] if name in summary]


def audit_line(directory: Path, name: str) -> str:
    """Where the audit of a learned reward stands, from the report in ``directory``; empty without one.

    >>> import tempfile
    >>> directory = Path(tempfile.mkdtemp())
    >>> reasons = ["The idle robot earns more.", "Noise earns more."]
    >>> _ = (directory / "audit.json").write_text(json.dumps({"passed": False, "reasons": reasons}))
    >>> audit_line(directory, "demo")
    'Audit of demo: failed (2 criteria). The idle robot earns more.'
    """
    file = directory / "audit.json"
    if not file.is_file():
        return ""
    verdict = json.loads(file.read_text(encoding="utf-8"))
    if not (reasons := verdict["reasons"]):
        return f"Audit of {name}: passed."
    return f"Audit of {name}: failed ({len(reasons)} {'criterion' if len(reasons) == 1 else 'criteria'}). {reasons[0]}"
