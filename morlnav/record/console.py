"""What is printed in a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager

import pandas as pd
from rich import box
from rich.console import Console
from rich.table import Table
from tqdm import tqdm


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
    rows = [[f"{value:.4g}" for value in row] for row in table.itertuples(index=False)]
    choices = (whole, *(broken[:count] for count in range(len(whole), 0, -1)))
    print_first_that_fits((make_table(names, rows) for names in choices), console)


def make_table(headings: Sequence[str], rows: Iterable[Sequence[str]], label: str | None = None) -> Table:
    """An aligned table of as many columns as there are headings; the first one is text if it has a ``label``."""
    table = Table(box=box.SIMPLE_HEAD)
    if label is not None:
        table.add_column(label)
    for heading in headings:
        table.add_column(heading, justify="right", vertical="bottom")
    for row in rows:
        table.add_row(*row[: len(table.columns)])
    return table


def print_first_that_fits(tables: Iterable[Table], console: Console) -> None:
    """Print the first table for which the console has room, or else the last one."""
    for table in tables:
        if console.measure(table, options=console.options.update(width=1000)).maximum <= console.width:
            break
    console.print(table)


@contextmanager
def stage(name: str, show: bool) -> Iterator[Callable[[str], None]]:
    """One line: the stage's name, and the time it took. Gives a function that adds a remark to the line."""
    with tqdm(desc=name, bar_format="{desc}: {elapsed}{postfix}", disable=not show) as line:
        remarks: list[str] = []

        def remark(text: str) -> None:
            remarks.append(text)
            line.set_postfix_str(", ".join(remarks))

        yield remark
