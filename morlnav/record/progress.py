"""The progress display of a pipeline."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm


@contextmanager
def stage(name: str, show: bool) -> Iterator[Callable[[str], None]]:
    """One line: the stage's name, and the time it took. Gives a function that adds a remark to the line."""
    with tqdm(desc=name, bar_format="{desc}: {elapsed}{postfix}", disable=not show) as line:
        remarks: list[str] = []

        def remark(text: str) -> None:
            remarks.append(text)
            line.set_postfix_str(", ".join(remarks))

        yield remark
