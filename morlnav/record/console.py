"""What is printed in a terminal."""

from __future__ import annotations

import pandas as pd
from rich import box
from rich.console import Console
from rich.table import Table


def make_console() -> Console:
    """Writes to the standard output, in a notebook too: plain text that wraps at words.

    >>> make_console().print("Ready.")
    Ready.
    """
    return Console(force_jupyter=False, highlight=False, markup=False, emoji=False)


def print_table(table: pd.DataFrame, console: Console) -> None:
    """Print numbers as an aligned table: names broken at words if need be, and as many columns as there is room for.

    >>> table = pd.DataFrame({"speed": [1.0, 0.5], "utility": [20.0, 18.25]})
    >>> print_table(table, make_console())  # doctest: +NORMALIZE_WHITESPACE
    <BLANKLINE>
     speed   utility
    ─────────────────
         1        20
       0.5     18.25
    <BLANKLINE>
    """
    whole = list(table)
    broken = [name.replace(" ", "\n") for name in whole]
    for names in (whole, *(broken[:count] for count in range(len(whole), 0, -1))):
        shown = Table(box=box.SIMPLE_HEAD)
        for name in names:
            shown.add_column(name, justify="right", vertical="bottom")
        for row in table.itertuples(index=False):
            shown.add_row(*(f"{value:.4g}" for value in row[: len(names)]))
        if console.measure(shown, options=console.options.update(width=1000)).maximum <= console.width:
            break
    console.print(shown)
