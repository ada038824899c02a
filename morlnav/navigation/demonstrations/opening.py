"""Files as text, whatever their encoding and compression; what they are where they hold no text."""

from __future__ import annotations

import bz2
import codecs
import gzip
import lzma
from pathlib import Path

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


def what_folder(path: Path) -> str:
    """What a folder is that is no table, and where it is read."""
    if (path / "metadata.yaml").is_file():
        return "a ROS 2 bag, which is read by morlnav-record --import; its package: pip install 'morlnav[ros]'"
    if (path / "demonstrations.json").is_file():
        return "a folder of demonstrations already; train on it, or record into it"
    if (path / "meta" / "info.json").is_file():
        return "a LeRobot data set, whose tables are Parquet files; write them as CSV: pandas.read_parquet(FILE)"
    if any(path.glob("*.db3")) or any(path.glob("*.mcap")):
        return "a ROS 2 bag without its metadata.yaml; give the .db3 or .mcap file in it"
    return "a folder, and neither a ROS 2 bag nor demonstrations; give the files in it"


def text_of(path: Path, data: bytes) -> str:
    """The text in a file.

    Args:
        path: of the file, for messages.
        data: its content.

    Raises:
        ValueError: for a damaged archive, and for what is no text, saying what it is.

    Examples:
        >>> text_of(Path("drive.csv"), gzip.compress(b"x,y"))
        'x,y'
    """
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
