"""Tables for pages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown_table(headings: Iterable[str], rows: Iterable[Iterable[object]], align: Sequence[str] = ("--:",)) -> str:
    """Rows as a Markdown table; the last alignment is that of all columns from there on.

    >>> print(markdown_table(["room", "SR", "CR"], [["hall", "100.0", "0.0"]], align=(":--", "--:")))
    | room | SR | CR |
    | :-- | --: | --: |
    | hall | 100.0 | 0.0 |
    """
    headings = list(headings)
    rule = [*align, *align[-1:] * len(headings)][: len(headings)]
    lines = ([str(cell).replace("|", " ") for cell in line] for line in (headings, rule, *rows))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
