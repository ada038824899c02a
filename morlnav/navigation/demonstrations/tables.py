"""Files of any kind as tables."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from morlnav.navigation.demonstrations.arrays import read_arrays
from morlnav.navigation.demonstrations.json_table import read_records
from morlnav.navigation.demonstrations.opening import text_of, what_folder
from morlnav.navigation.demonstrations.table import Table
from morlnav.navigation.demonstrations.text_table import read_text


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
        raise ValueError(f"{path} is {what_folder(path)}.")
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}.")
    data = path.read_bytes()
    if not data.strip():
        raise ValueError(f"{path} holds no sample: it is empty ({len(data)} bytes).")
    is_npz = data.startswith(b"PK\x03\x04") and b".npy" in data
    text = "" if is_npz else text_of(path, data)
    is_json = bool(re.match(r"\s*(\{|\[\s*\{)", text)) or path.suffix in (".json", ".jsonl", ".ndjson")
    if (is_npz or is_json) and (separator or decimal or names):
        raise ValueError(f"{path} is no table of text, for which a separator, decimal sign or names would be told.")
    if is_npz:
        return read_arrays(path)
    if is_json:
        return read_records(path, text)
    return read_text(path, text, separator, decimal, names)
