"""Tables of trajectories: named columns of cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

BLANK = ("", "nan", "null", "none", "na", "n/a", "-nan", "nat")
"""Cells that tell nothing."""
MOST_NAMES = 50
"""Of more columns the rest is not listed."""
LONGEST = 60
"""Of longer cells the rest is not shown."""


@dataclass(frozen=True)
class Table:
    """Columns of a file by name.

    Attributes:
        path: of the file, to name it in messages.
        columns: cells ``[N]`` by the column's name, as text or numbers.
        row: where each sample stands in its file, ``[N]``, counted as ``place`` says.
        place: what a row is called in messages, with a place for its number.
        notes: what was noticed in reading, a few words each.
        units: that a row of its own tells, by column.
    """

    path: Path
    columns: Mapping[str, pd.Series]
    row: np.ndarray
    place: str = "row {}"
    notes: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        names = list(self.columns)
        more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
        return f"the columns are {', '.join(names[:MOST_NAMES])}{more}"

    def at(self, sample: int) -> str:
        """Where a sample stands in the file, such as ``"row 7"``."""
        return self.place.format(self.row[sample])

    def numbers(self, name: str, blank: bool = False) -> np.ndarray:
        """A column as finite ``float64`` ``[N]``, or ``int64`` where all are whole.

        Args:
            name: of the column.
            blank: let cells be empty, which become NaN.

        Raises:
            ValueError: naming file, row and column of the first cell that is no number.
        """
        cells = self.columns[name]
        if not pd.api.types.is_numeric_dtype(cells):
            cells = cells.mask(cells.astype(str).str.strip().str.lower().isin(BLANK))
        values = pd.to_numeric(cells, errors="coerce")
        expected, wrong = "number", (values.isna() & ~(cells.isna() & blank)) | (values.dtype.kind == "b")
        if not wrong.any():
            expected, wrong = "finite number", (values.abs() == np.inf) | (values.dtype.kind == "c")
        if wrong.any():
            sample = int(wrong.to_numpy().argmax())
            text = str(cells[sample])
            shown = repr(text[:LONGEST] + "…" * (len(text) > LONGEST))
            found = values[sample] if expected != "number" else shown
            found = "nothing" if pd.isna(cells[sample]) else found
            raise ValueError(f"{self.path}, {self.at(sample)}, column {name}: expected a {expected}, got {found}.")
        return values.to_numpy()
