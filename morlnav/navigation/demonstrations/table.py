"""Tables as others write them: text of any dialect, arrays, or JSON by lines, as named columns of cells."""

from __future__ import annotations

import bz2
import csv
import gzip
import json
import lzma
import re
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

PACKED = {b"\x1f\x8b": gzip.decompress, b"BZh": bz2.decompress, b"\xfd7zXZ": lzma.decompress}
FOREIGN = {
    b"PAR1": "a Parquet file; write it as CSV: pandas.read_parquet(FILE).to_csv(...)",
    b"\x93NUMPY": "a single NumPy array (.npy); save named arrays by numpy.savez",
    b"\x89HDF": "an HDF5 file; of a Minari data set, give its name as minari:NAME",
    b"PK\x03\x04": "a zip archive without arrays, as spreadsheets are; unpack it, or save the sheet as CSV",
    b"SQLite format 3": "the storage of a ROS 2 bag; give the folder that holds it and metadata.yaml",
    b"\x89MCAP": "the storage of a ROS 2 bag; give the folder that holds it and metadata.yaml",
    b"%PDF": "a PDF document",
}
SEPARATORS = (";", "\t", "|", ",")
BLANK = ("", "nan", "null", "none", "na", "n/a", "-nan")
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
    """

    path: Path
    columns: Mapping[str, pd.Series]
    row: np.ndarray
    place: str = "row {}"
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"the columns are {', '.join(self.columns)}"

    def at(self, sample: int) -> str:
        """Where a sample stands in the file, such as ``"row 7"``."""
        return self.place.format(self.row[sample])

    def numbers(self, name: str, blank: bool = False) -> np.ndarray:
        """A column as ``float64`` ``[N]``, or ``int64`` where all are whole.

        Args:
            name: of the column.
            blank: let cells be empty, which become NaN.

        Raises:
            ValueError: naming file, row and column of the first cell that is no number.
        """
        cells = self.columns[name]
        if cells.dtype == object:
            cells = cells.mask(cells.str.lower().isin(BLANK))
        values = pd.to_numeric(cells, errors="coerce")
        wrong = values.isna() & ~(cells.isna() & blank)
        if wrong.any():
            sample = int(wrong.to_numpy().argmax())
            found = "nothing" if pd.isna(cells[sample]) else repr(str(cells[sample]))
            raise ValueError(f"{self.path}, {self.at(sample)}, column {name}: expected a number, got {found}.")
        return values.to_numpy()


def read_table(
    path: Path, separator: str | None = None, decimal: str | None = None, names: Sequence[str] | None = None
) -> Table:
    """Read a file of text (CSV, TSV and their kin, also compressed), of JSON by lines, or of arrays (NPZ).

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
    is_npz = data.startswith(b"PK") and _is_npz(path)
    text = "" if is_npz else _text(path, data)
    is_json = text.lstrip().startswith("{") or path.suffix == ".ndjson"
    if (is_npz or is_json) and (separator or decimal or names):
        raise ValueError(f"{path} is no table of text, for which a separator, decimal sign or names would be told.")
    if is_npz or is_json:
        return _arrays(path) if is_npz else _tracks(path, text)
    return _cells(path, text, separator, decimal, names)


def _folder(path: Path) -> str:
    if (path / "metadata.yaml").is_file():
        return "a ROS 2 bag, which is read by morlnav-record --import; its package: pip install 'morlnav[ros]'"
    if (path / "demonstrations.json").is_file():
        return "a folder of demonstrations already; train on it, or record into it"
    if (path / "meta" / "info.json").is_file():
        return "a LeRobot data set, whose tables are Parquet files; write them as CSV: pandas.read_parquet(FILE)"
    return "a folder, and neither a ROS 2 bag nor demonstrations; give the files in it"


def _is_npz(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.endswith(".npy") for name in archive.namelist())
    except zipfile.BadZipFile:
        return False


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
    if data.startswith(b"#ROSBAG"):
        raise ValueError(f"{path} is a ROS 1 bag; its name has to end with .bag.")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    if b"\0" in data:
        raise ValueError(f"{path} is no text, nor a file of arrays or a bag; trajectories are read from .csv and .npz.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")  # as spreadsheets write


def _cells(path: Path, text: str, separator: str | None, decimal: str | None, names: Sequence[str] | None) -> Table:
    lines = [(number, line) for number, line in enumerate(re.split(r"\r\n|\r|\n", text), 1) if line.strip(" \t;,")]
    if directive := re.fullmatch(r"sep=(.)", lines[0][1].strip()) if lines else None:
        separator, lines = separator or directive[1], lines[1:]
    remarks = [(number, line) for number, line in lines if line.lstrip().startswith(("#", "%", "//"))]
    lines = [entry for entry in lines if entry not in remarks] if remarks else lines
    if not lines:
        raise ValueError(f"{path} holds no sample.")
    separator = separator or _separator([line for _, line in lines[:2]])
    first, *_ = rows = _split(path, lines, separator)
    if names is not None:
        header = list(names)
    elif not any(_is_number(cell) for cell in first if cell):
        header, rows, lines = first, rows[1:], lines[1:]
    elif remarks and len(found := _split(path, [(0, remarks[-1][1].lstrip(" #%/"))], separator)[0]) == len(first):
        header = found  # as numpy.savetxt and rostopic write it
    elif len(first) in HEADERS and not _is_number(first[2]):
        header = list(HEADERS[len(first)])
    else:
        raise ValueError(
            f"{path}, row {lines[0][0]}: expected the names of the columns, got numbers; "
            f"name the {len(first)} columns with --names, as in --names time x y heading."
        )
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
    notes = () if not remarks else (f"{len(remarks)} lines of comment",)
    columns = {
        name: pd.Series(list(cells), dtype=object) for name, cells in zip(header, zip(*rows, strict=True), strict=True)
    }
    if decimal == "," or (decimal is None and _has_comma(columns.values())):
        columns = {name: cells.str.replace(r"^([-+]?\d*),(\d+(?:[eE][-+]?\d+)?)$", r"\1.\2", regex=True)
                   for name, cells in columns.items()}  # fmt: skip
        notes = (*notes, "decimal commas")
    return Table(path, columns, np.array([number for number, _ in lines]), notes=notes)


def _split(path: Path, lines: Sequence[tuple[int, str]], separator: str) -> list[list[str]]:
    texts = [line for _, line in lines]
    if separator.isspace() and separator != "\t":
        return [text.split() for text in texts]
    try:
        rows = list(csv.reader(texts, delimiter=separator, skipinitialspace=True, strict=True))
    except (csv.Error, TypeError) as error:
        raise ValueError(f"{path} is no table separated by {separator!r}: {error}.") from error
    if len(rows) != len(texts):
        raise ValueError(f"{path}: a quoted cell goes on over several rows, which no number does.")
    return [[cell.strip() for cell in row] for row in rows]


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


def _tracks(path: Path, text: str) -> Table:
    """JSON by lines, as TrajNet++ has it: of its lines ``{"track": {"f": …, "p": …, "x": …, "y": …}}``, these parts."""
    rows, places = [], []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
        except ValueError as error:
            raise ValueError(f"{path}, row {number} is no line of JSON: {error}.") from error
        entry = entry.get("track", {} if "scene" in entry else entry) if isinstance(entry, dict) else {}
        if entry:
            rows.append({{"f": "frame", "p": "track_id"}.get(name, name): value for name, value in entry.items()})
            places.append(number)
    if not rows:
        raise ValueError(f"{path} holds no sample.")
    frame = pd.json_normalize(rows)
    return Table(path, {str(name): frame[name] for name in frame}, np.array(places))


PARTS = {
    "pose": ("x", "y", "heading"),
    "action": ("v", "omega"),
    "position": ("x", "y", "z"),
    "start": ("start_x", "start_y", "start_heading"),
    "goal": ("goal_x", "goal_y"),
    "human": ("human_x", "human_y"),
    "boxes": ("x", "y", "half_length", "half_width", "angle"),
}
"""Arrays of several columns, and what these are."""


def _arrays(path: Path) -> Table:
    """An NPZ file: arrays ``[N]`` are columns, ``pose`` and its kin several, ``[E, …]`` has a row per episode."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is no .npz file of numbers: {error}") from error
    per_sample = [name for name in ("pose", "action", "position") if name in arrays]
    flat = [len(value) for value in arrays.values() if value.ndim == 1]
    count = len(np.atleast_1d(arrays[per_sample[0]])) if per_sample else max(flat, default=0)
    if not count:
        reason = "" if per_sample or flat else ": expected an array pose or action, got neither"
        raise ValueError(f"{path} holds no sample{reason}; the arrays are {', '.join(arrays)}.")
    ids = next((arrays[name] for name in arrays if name.startswith("episode")), np.zeros(count))
    if ids.shape != (count,):
        raise ValueError(f"{path}, array episode: expected the shape [{count}], got {list(ids.shape)}.")
    episode, seen = pd.factorize(ids)
    columns: dict[str, np.ndarray] = {}
    for name, value in arrays.items():
        parts, length = PARTS.get(name), count if name in ("pose", "action", "position") else len(seen)
        if name in ("orientation", "quaternion") and value.shape == (count, 4):
            columns |= {f"q{i}": value[:, i] for i in range(4)}
        elif name == "boxes":
            if value.ndim != 3 or value.shape[0] != len(seen) or value.shape[2] != 5:
                raise ValueError(f"{path}, array boxes: expected the shape [{length}, K, 5], got {list(value.shape)}.")
            columns |= {f"box{k + 1}_{part}": value[episode, k, j]
                        for k in range(value.shape[1]) for j, part in enumerate(parts)}  # fmt: skip
        elif parts is not None:
            wide = [n for n in ((2, 3) if name == "position" else (len(parts),)) if value.shape == (length, n)]
            if not wide:
                raise ValueError(
                    f"{path}, array {name}: expected the shape [{length}, {len(parts)}], got {list(value.shape)}."
                )
            rows = value if length == count and name in per_sample else value[episode]
            columns |= dict(zip(parts, rows.T, strict=False))
        elif value.ndim == 1 and len(value) == count:
            columns[name] = value
        else:
            columns[name] = np.full(count, np.nan)  # of no use, and told so
            if _time_like(name):
                raise ValueError(f"{path}, array {name}: expected the shape [{count}], got {list(value.shape)}.")
    kind = next(iter(per_sample), "the arrays")
    series = {
        name: pd.Series(value.astype(object) if value.dtype.kind in "US" else value) for name, value in columns.items()
    }
    return Table(path, series, np.arange(count), f"row {{}} of {kind}")


def _time_like(name: str) -> bool:
    return name.lower().startswith(("time", "stamp", "episode"))
