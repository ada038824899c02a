"""Tables of arrays: NPZ files, where a column is an array, and an array may be several columns."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.names import parse
from morlnav.navigation.demonstrations.table import Table

PARTS = {
    "pose": ("x", "y", "heading"),
    "action": ("v", "omega"),
    "position": ("x", "y", "z"),
    "orientation": ("q0", "q1", "q2", "q3"),
    "quaternion": ("q0", "q1", "q2", "q3"),
    "start": ("start_x", "start_y", "start_heading"),
    "goal": ("goal_x", "goal_y"),
    "human": ("human_x", "human_y"),
}
"""Arrays of several columns, and what these are."""
PER_SAMPLE = ("pose", "action", "position")
BOX = ("x", "y", "half_length", "half_width", "angle")


def read_arrays(path: Path) -> Table:
    """Read an NPZ file; nothing is unpickled.

    Arrays ``[N]`` are columns, also as ``[N, 1]`` or the fields of a record array; ``pose`` and its kin are several. Of
    a scene they have a row per episode, ``[E, …]``, or per sample.

    Raises:
        ValueError: naming file and array, for damage, pickles, or another shape.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "drive.npz"
        >>> np.savez(file, pose=np.zeros((2, 3)), goal=np.ones((1, 2)))
        >>> table = read_arrays(file)
        >>> list(table.columns), table.at(1)
        (['x', 'y', 'heading', 'goal_x', 'goal_y'], 'row 1 of pose')
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is no .npz file of numbers: {error}") from error
    for name, value in list(arrays.items()):
        if value.dtype.names and value.ndim == 1:
            arrays |= {field: value[field] for field in arrays.pop(name).dtype.names}
        elif value.ndim == 2 and value.shape[1] == 1:
            arrays[name] = value[:, 0]
    kinds = [name for name in PER_SAMPLE if name in arrays]
    flat = [len(value) for value in arrays.values() if value.ndim == 1]
    count = len(np.atleast_1d(arrays[kinds[0]])) if kinds else max(flat, default=0)
    if not count:
        reason = "" if kinds or flat else ": expected an array pose or action, got neither"
        raise ValueError(f"{path} holds no sample{reason}; the arrays are {', '.join(arrays)}.")
    ids = next((arrays[name] for name in arrays if name.startswith("episode")), np.zeros(count))
    if ids.shape != (count,):
        raise _wrong(path, "episode", f"[{count}]", ids)
    episode, seen = pd.factorize(ids)
    columns: dict[str, np.ndarray] = {}
    for name, value in arrays.items():
        turned = name in ("orientation", "quaternion")
        parts, length = PARTS.get(name), count if turned or name in PER_SAMPLE else len(seen)
        if name == "boxes":
            if value.ndim != 3 or value.shape[0] != len(seen) or value.shape[2] != 5:
                raise _wrong(path, name, f"[{length}, K, 5]", value)
            columns |= {f"box{k + 1}_{part}": value[episode, k, j]
                        for k in range(value.shape[1]) for j, part in enumerate(BOX)}  # fmt: skip
        elif parts is not None and not (turned and value.ndim == 1):
            wide = value.ndim == 2 and (value.shape[1] == len(parts) or (name, value.shape[1]) == ("position", 2))
            if not wide or len(value) not in (length, count):
                raise _wrong(path, name, f"[{length}, {len(parts)}]", value)
            columns |= dict(zip(parts, (value if len(value) == count else value[episode]).T, strict=False))
        elif value.shape in ((count,), ()):
            columns[name] = np.broadcast_to(value, count)
        elif parse(name)[0] not in (None, "v", "omega"):
            raise _wrong(path, name, f"[{count}]", value)
        else:
            columns[name] = np.full(count, np.nan)  # of no use, and told so
    series = {name: pd.Series(value.astype("U").astype(object) if value.dtype.kind in "US" else value)
              for name, value in columns.items()}  # fmt: skip
    return Table(path, series, np.arange(count), f"row {{}} of {next(iter(kinds), 'the arrays')}")


def _wrong(path: Path, name: str, shape: str, value: np.ndarray) -> ValueError:
    return ValueError(f"{path}, array {name}: expected the shape {shape}, got {list(value.shape)}.")
