"""Tables in JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from morlnav.navigation.demonstrations.table import Table


def read_records(path: Path, text: str) -> Table:
    """JSON: a list of rows, columns by name, or a row in each line.

    Of the lines of TrajNet++, ``{"track": {"f": …, "p": …, "x": …, "y": …}}`` alone are rows.
    """
    try:
        whole = json.loads(text)
    except (ValueError, RecursionError):
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
    frame = pd.json_normalize(rows).map(lambda cell: json.dumps(cell) if isinstance(cell, list | dict) else cell)
    return Table(path, {str(name): frame[name] for name in frame}, np.array(places), place)
