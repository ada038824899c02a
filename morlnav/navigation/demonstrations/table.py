"""Tables as others write them: text of any dialect, or JSON, as named columns of cells."""

from __future__ import annotations

import bz2
import codecs
import csv
import gzip
import json
import lzma
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.names import UNITS

PACKED = {b"\x1f\x8b": gzip.decompress, b"BZh": bz2.decompress, b"\xfd7zXZ": lzma.decompress}
FOREIGN = {
    b"PAR1": "a Parquet file; write it as CSV: pandas.read_parquet(FILE).to_csv(...)",
    b"ARROW1": "an Arrow or Feather file; write it as CSV: pandas.read_feather(FILE).to_csv(...)",
    b"\x93NUMPY": "a single NumPy array (.npy); save named arrays by numpy.savez",
    b"\x89HDF": "an HDF5 file; of a Minari data set, give its name as minari:NAME",
    b"MATLAB": "a MATLAB file; write it as CSV by writetable, or save named arrays by numpy.savez",
    b"PK\x03\x04": "a zip archive without arrays, as spreadsheets are; unpack it, or save the sheet as CSV",
    b"\xd0\xcf\x11\xe0": "a spreadsheet of old Excel; save the sheet as CSV",
    b"SQLite format 3": "the storage of a ROS 2 bag; give the folder that holds it and metadata.yaml",
    b"\x89MCAP": "the storage of a ROS 2 bag; give the folder that holds it and metadata.yaml",
    b"#ROSBAG": "a ROS 1 bag; its name has to end with .bag",
    b"\x80\x04": "a pickle, which could run anything; write its table as CSV",
    b"\x80\x05": "a pickle, which could run anything; write its table as CSV",
    b"%PDF": "a PDF document",
    b"<!DOCTYPE": "a web page, as comes where a download wants a login",
    b"version https://git-lfs": "a pointer of Git LFS in place of the file; fetch it by git lfs pull",
}
MARKS = {codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32", codecs.BOM_UTF16_LE: "utf-16",
         codecs.BOM_UTF16_BE: "utf-16"}  # fmt: skip
SEPARATORS = (";", "\t", "|", ",")
BLANK = ("", "nan", "null", "none", "na", "n/a", "-nan", "nat")
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
        return f"the columns are {', '.join(self.columns)}"

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
        expected, wrong = "number", values.isna() & ~(cells.isna() & blank)
        if not wrong.any():
            expected, wrong = "finite number", (values.abs() == np.inf) | (values.dtype.kind == "c")
        if wrong.any():
            sample = int(wrong.to_numpy().argmax())
            found = values[sample] if expected != "number" else repr(str(cells[sample]))
            found = "nothing" if pd.isna(cells[sample]) else found
            raise ValueError(f"{self.path}, {self.at(sample)}, column {name}: expected a {expected}, got {found}.")
        return values.to_numpy()


def read_table(
    path: Path, separator: str | None = None, decimal: str | None = None, names: Sequence[str] | None = None
) -> Table:
    """Read a file of text (CSV, TSV and their kin, also compressed), of JSON, or of arrays (NPZ).

    Args:
        path: of the file; nothing is unpickled.
        separator: between fields; by default what the header is separated by.
        decimal: sign, ``"."`` or ``","``; by default what the cells have.
        names: of the columns, for a file without a header.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: in one sentence that names the file, if it is of another kind, or rows do not fit the header.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "drive.csv"
        >>> _ = file.write_text("# by hand\\nx [m]; y [m]\\n\\n0,5; 1,0\\n")
        >>> table = read_table(file)
        >>> table.at(0), table.numbers("x [m]")
        ('row 4', array([0.5]))
    """
    if path.is_dir():
        raise ValueError(f"{path} is {_folder(path)}.")
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}.")
    data = path.read_bytes()
    if not data.strip():
        raise ValueError(f"{path} holds no sample: it is empty ({len(data)} bytes).")
    is_npz = data.startswith(b"PK\x03\x04") and b".npy" in data
    text = "" if is_npz else _text(path, data)
    is_json = bool(re.match(r"\s*(\{|\[\s*\{)", text)) or path.suffix in (".json", ".jsonl", ".ndjson")
    if (is_npz or is_json) and (separator or decimal or names):
        raise ValueError(f"{path} is no table of text, for which a separator, decimal sign or names would be told.")
    if is_npz:
        from morlnav.navigation.demonstrations.arrays import read_arrays  # which makes tables

        return read_arrays(path)
    return _records(path, text) if is_json else _cells(path, text, separator, decimal, names)


def _folder(path: Path) -> str:
    if (path / "metadata.yaml").is_file():
        return "a ROS 2 bag, which is read by morlnav-record --import; its package: pip install 'morlnav[ros]'"
    if (path / "demonstrations.json").is_file():
        return "a folder of demonstrations already; train on it, or record into it"
    if (path / "meta" / "info.json").is_file():
        return "a LeRobot data set, whose tables are Parquet files; write them as CSV: pandas.read_parquet(FILE)"
    if any(path.glob("*.db3")) or any(path.glob("*.mcap")):
        return "a ROS 2 bag without its metadata.yaml; give the .db3 or .mcap file in it"
    return "a folder, and neither a ROS 2 bag nor demonstrations; give the files in it"


def _text(path: Path, data: bytes) -> str:
    for magic, unpack in PACKED.items():
        if data.startswith(magic):
            try:
                data = unpack(data)
            except (OSError, EOFError, ValueError, lzma.LZMAError) as error:
                raise ValueError(f"{path} is compressed and damaged: {error}") from error
    for magic, what in FOREIGN.items():
        if data.startswith(magic):
            raise ValueError(f"{path} is {what}.")
    encoding = next((name for mark, name in MARKS.items() if data.startswith(mark)), None)
    high, low = (data[i::2].count(0) > 0.4 * len(data) for i in (0, 1))
    if encoding is None and high != low:
        encoding = "utf-16-be" if high else "utf-16-le"
    try:
        text, readable = data.decode(encoding or "utf-8-sig", errors="replace" if encoding else "strict"), True
    except UnicodeDecodeError:
        text, readable = data.decode("cp1252", errors="replace"), False  # as spreadsheets write
    if "\0" in text:
        if readable and "\0" not in text.rstrip("\0"):
            raise ValueError(f"{path} ends in zero bytes, as when the power goes while it is written; cut them off.")
        raise ValueError(f"{path} is no text, nor a file of arrays or a bag; trajectories are read from .csv and .npz.")
    return text.replace("\u2212", "-").rstrip("\x1a")  # a minus sign, and how DOS ended a text


def _cells(path: Path, text: str, separator: str | None, decimal: str | None, names: Sequence[str] | None) -> Table:
    lines = [(number, line) for number, line in enumerate(re.split(r"\r\n|\r|\n", text), 1) if line.strip(" \t;,")]
    if directive := re.fullmatch(r"sep=(.)", lines[0][1].strip()) if lines else None:
        separator, lines = separator or directive[1], lines[1:]
    remarks = [entry for entry in lines if entry[1].lstrip().startswith(("#", "%", "//"))]
    lines = [entry for entry in lines if entry not in remarks] if remarks else lines
    if not lines:
        raise ValueError(f"{path} holds no sample.")
    above = _lines_above([line for _, line in lines], separator) if names is None else 0
    notes = (f"{len(remarks)} lines of comment",) * bool(remarks) + (f"{above} lines above the header",) * bool(above)
    lines = lines[above:]
    separator = separator or _separator([line for _, line in lines[:2]])
    first, *_ = rows = _split(path, lines, separator)
    if names is not None:
        header = list(names)
    elif not any(_is_number(cell) for cell in first if cell):
        header, rows, lines = first, rows[1:], lines[1:]
    elif remarks and len(found := _fields(remarks[-1][1].lstrip(" #%/"), separator)) == len(first):
        header = found  # as numpy.savetxt and rostopic write it
    elif len(first) in HEADERS and not _is_number(first[2]):
        header = list(HEADERS[len(first)])
    else:
        raise ValueError(
            f"{path}, row {lines[0][0]}: expected the names of the columns, got numbers; "
            f"name the {len(first)} columns with --names, as in --names time x y heading."
        )
    units = _units(rows[0]) if len(rows) > 1 and len(rows[0]) == len(header) else []
    if units:
        rows, lines = rows[1:], lines[1:]
    if not rows:
        raise ValueError(f"{path} holds no sample.")
    while len(header) > 1 and not header[-1] and not any("".join(row[len(header) - 1 :]) for row in rows):
        header = header[:-1]
    if all(len(row) > len(header) and not any(row[len(header) :]) for row in rows):
        rows = [row[: len(header)] for row in rows]  # a separator at the end of every row
    for (number, _), row in zip(lines, rows, strict=True):
        if len(row) != len(header):
            raise ValueError(
                f"{path}, row {number}: expected {len(header)} fields as in the header, got {len(row)}"
                f"{_guess(separator, row, header)}."
            )
    header = [name or f"column {i + 1}" for i, name in enumerate(header)]
    if twice := [name for name in header if header.count(name) > 1]:
        raise ValueError(f"{path}: two columns are called {twice[0]}; give each a name of its own.")
    columns = {
        name: pd.Series(list(cells), dtype=object) for name, cells in zip(header, zip(*rows, strict=True), strict=True)
    }
    if decimal == "," or (decimal is None and _has_comma(columns.values())):
        columns = {name: cells.str.replace(r"^([-+]?\d*),(\d+(?:[eE][-+]?\d+)?)$", r"\1.\2", regex=True)
                   for name, cells in columns.items()}  # fmt: skip
        notes = (*notes, "decimal commas")
    told = {name: unit for name, unit in zip(header, units, strict=False) if unit}
    return Table(path, columns, np.array([number for number, _ in lines]), notes=notes, units=told)


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
        return "; are these decimal commas? Then separate the fields by semicolons or tabs"
    if len(row) == len(header) + 1:
        return "; is the first column an index without a name"
    return "; is the file cut off here" if len(row) < len(header) else ""


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


def _records(path: Path, text: str) -> Table:
    """JSON: a list of rows, columns by name, or a row in each line.

    Of the lines of TrajNet++, ``{"track": {"f": …, "p": …, "x": …, "y": …}}`` alone are rows.
    """
    try:
        whole = json.loads(text)
    except ValueError:
        whole = None
    if isinstance(whole, dict) and whole and all(isinstance(cells, list) for cells in whole.values()):
        if len({len(cells) for cells in whole.values()}) > 1:
            lengths = ", ".join(f"{name} {len(cells)}" for name, cells in whole.items())
            raise ValueError(f"{path}: expected columns of one length, got {lengths}.")
        whole = [dict(zip(whole, row, strict=True)) for row in zip(*whole.values(), strict=True)]
    if isinstance(whole, list):
        entries, place = list(enumerate(whole)), "entry {}"
    else:
        entries, place = [], "row {}"
        for number, line in enumerate(text.splitlines(), 1):
            try:
                entries += [(number, json.loads(line))] if line.strip() else []
            except (ValueError, RecursionError) as error:
                raise ValueError(f"{path}, row {number} is no line of JSON: {error}.") from error
    rows, places = [], []
    for number, entry in entries:
        entry = entry.get("track", {} if "scene" in entry else entry) if isinstance(entry, dict) else {}
        if entry:
            rows.append({{"f": "frame", "p": "track_id"}.get(name, name): value for name, value in entry.items()})
            places.append(number)
    if not rows:
        raise ValueError(f"{path} holds no sample.")
    frame = pd.json_normalize(rows)
    return Table(path, {str(name): frame[name] for name in frame}, np.array(places), place)
