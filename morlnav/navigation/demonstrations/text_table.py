"""Tables as others write them: text of any dialect, as named columns of cells."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.names import UNITS
from morlnav.navigation.demonstrations.table import Table

SEPARATORS = (";", "\t", "|", ",")
LINES_ABOVE = 40
"""Most lines of a preamble over the header."""
HEADERS = {  # what `ros2 topic echo --csv` prints, by its number of fields
    10: ("stamp_sec", "stamp_nanosec", "frame_id", "x", "y", "z", "qx", "qy", "qz", "qw"),
    46: ("stamp_sec", "stamp_nanosec", "frame_id", "x", "y", "z", "qx", "qy", "qz", "qw",
         *(f"covariance_{i}" for i in range(36))),
    89: ("stamp_sec", "stamp_nanosec", "frame_id", "child_frame_id", "x", "y", "z", "qx", "qy", "qz", "qw",
         *(f"covariance_{i}" for i in range(36)), *(f"twist_{i}" for i in range(6)),
         *(f"twist_covariance_{i}" for i in range(36))),
}  # fmt: skip


def read_text(path: Path, text: str, separator: str | None, decimal: str | None, names: Sequence[str] | None) -> Table:
    """A table in a text.

    Args:
        path: of the file, for messages.
        text: with a row in each line.
        separator: between fields; by default what the header is separated by.
        decimal: sign; by default what the cells have.
        names: of the columns, for a text without a header.

    Raises:
        ValueError: naming file and row, if they do not fit the header, or there is none.

    Examples:
        >>> read_text(Path("f"), "x;y\\n0,5;1,0", None, None, None).numbers("x")
        array([0.5])
    """
    lines = [(number, line) for number, line in enumerate(re.split(r"\r\n|\r|\n", text), 1) if line.strip(" \t;,")]
    if directive := re.fullmatch(r"sep=(.)", lines[0][1].strip()) if lines else None:
        separator, lines = separator or directive[1], lines[1:]
    remarks = [line for _, line in lines if _is_remark(line)]
    lines = [(number, line) for number, line in lines if not _is_remark(line)]
    if not lines:
        raise ValueError(f"{path} holds no sample.")
    above = _lines_above([line for _, line in lines], separator) if names is None else 0
    notes = (f"{len(remarks)} lines of comment",) * bool(remarks) + (f"{above} lines above the header",) * bool(above)
    lines = lines[above:]
    separator = separator or _separator([line for _, line in lines[:2]])
    rows, numbers = _split(path, lines, separator), [number for number, _ in lines]
    header = list(names) if names is not None else _header(path, rows[0], numbers[0], remarks, separator)
    if header is rows[0]:
        rows, numbers = rows[1:], numbers[1:]
    units = _units(rows[0]) if len(rows) > 1 and len(rows[0]) == len(header) else []
    if units:
        rows, numbers = rows[1:], numbers[1:]
    if not rows:
        raise ValueError(f"{path} holds no sample.")
    header, rows = _even(path, header, rows, numbers, separator)
    columns = {name: pd.Series(list(cells), dtype=object) for name, *cells in zip(header, *rows, strict=True)}
    if decimal == "," or (decimal is None and _has_comma(columns.values())):
        columns = {name: cells.str.replace(r"^([-+]?\d*),(\d+(?:[eE][-+]?\d+)?)$", r"\1.\2", regex=True)
                   for name, cells in columns.items()}  # fmt: skip
        notes = (*notes, "decimal commas")
    told = {name: unit for name, unit in zip(header, units, strict=False) if unit}
    return Table(path, columns, np.array(numbers), notes=notes, units=told)


def _is_remark(line: str) -> bool:
    return line.lstrip().startswith(("#", "%", "//"))


def _header(path: Path, first: list[str], number: int, remarks: Sequence[str], separator: str) -> list[str]:
    """Names of the columns: ``first`` itself, if it holds no numbers, or what stands in a comment above it."""
    if not any(_is_number(cell) for cell in first if cell):
        return first
    if remarks and len(found := _fields(remarks[-1].lstrip(" #%/"), separator)) == len(first):
        return found  # as numpy.savetxt and rostopic write it
    if len(first) in HEADERS and not _is_number(first[2]):
        return list(HEADERS[len(first)])
    raise ValueError(
        f"{path}, row {number}: expected the names of the columns, got numbers; name the {len(first)} columns with "
        f"--names, as in --names time x y heading."
    )


def _even(
    path: Path, header: list[str], rows: list[list[str]], numbers: Sequence[int], separator: str
) -> tuple[list[str], list[list[str]]]:
    """Header and rows of one length, each name once."""
    while len(header) > 1 and not header[-1] and not any("".join(row[len(header) - 1 :]) for row in rows):
        header = header[:-1]
    if all(len(row) > len(header) and not any(row[len(header) :]) for row in rows):
        rows = [row[: len(header)] for row in rows]  # a separator at the end of every row
    for number, row in zip(numbers, rows, strict=True):
        if len(row) != len(header):
            raise ValueError(
                f"{path}, row {number}: expected {len(header)} fields as in the header, got {len(row)}"
                f"{_guess(separator, row, header) or '.'}"
            )
    header = [name or f"column {i + 1}" for i, name in enumerate(header)]
    (name, count), *_ = Counter(header).most_common(1)
    if count > 1:
        raise ValueError(f"{path}: two columns are called {name}; give each a name of its own.")
    return header, rows


def _lines_above(lines: Sequence[str], separator: str | None) -> int:
    """How many lines stand above the header, which has as many fields as the rows of numbers under it."""
    sample = lines[len(lines) // 2]
    for start in range(min(len(lines) // 2, LINES_ABOVE)):
        sign = separator or _separator([lines[start], sample])
        words, *under = (_fields(line, sign) for line in (lines[start], lines[start + 1], sample))
        fits = len(words) > 1 and all(0 <= len(row) - len(words) <= 1 for row in under)
        if fits and not any(map(_is_number, words)) and any(map(_is_number, under[-1])):
            return start
    return 0


def _units(row: Sequence[str]) -> list[str]:
    """Units of the columns, if a row holds nothing else; ``""`` where it tells none."""
    units = [re.sub(r"[\[\](){}]", "", cell).strip().lower() for cell in row]
    units = ["" if unit in ("-", "1") else unit for unit in units]
    known = {unit for kind in UNITS.values() for unit in kind}
    return units if any(units) and all(unit in known for unit in units if unit) else []


def _split(path: Path, lines: Sequence[tuple[int, str]], separator: str) -> list[list[str]]:
    texts = [line for _, line in lines]
    if separator.isspace() and separator != "\t":
        return [text.split() for text in texts]
    try:
        rows = list(csv.reader(texts, delimiter=separator, skipinitialspace=True, strict=True))
    except csv.Error as error:
        raise ValueError(f"{path} is no table separated by {separator!r}: {error}.") from error
    if len(rows) != len(texts):
        raise ValueError(f"{path}: a quoted cell goes on over several rows, which no number does.")
    return [[cell.strip() for cell in row] for row in rows]


def _fields(line: str, separator: str) -> list[str]:
    """The fields of one line, whatever is quoted in it."""
    if separator.isspace() and separator != "\t":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]


def _separator(lines: Sequence[str]) -> str:
    header, sample = lines[0], lines[-1]
    counts = {sep: header.count(sep) for sep in SEPARATORS if sep in header}
    fitting = [sep for sep, count in counts.items() if 0 <= sample.count(sep) - count <= 1]
    return (fitting or sorted(counts, key=counts.get, reverse=True) or [" " if len(header.split()) > 1 else ","])[0]


def _guess(separator: str, row: Sequence[str], header: Sequence[str]) -> str:
    if separator == "," and len(row) > len(header) and len(row) == 2 * len(header):
        return "; are these decimal commas? Then separate the fields by semicolons or tabs."
    if len(row) == len(header) + 1:
        return "; is the first column an index without a name?"
    return "; is the file cut off here?" if len(row) < len(header) else ""


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _has_comma(columns: Iterable[pd.Series]) -> bool:
    joined = pd.concat(list(columns))
    return bool(joined.str.fullmatch(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?").any()) and not bool(
        joined.str.fullmatch(r"[-+]?\d*\.\d+(?:[eE][-+]?\d+)?").any()
    )
