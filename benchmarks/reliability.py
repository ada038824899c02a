"""The record of what was killed and of what ran for hours, as a page.

``python -m benchmarks.reliability results/reliability`` reads ``kills_*.json``, as ``benchmarks.kills`` writes them,
``soak.csv`` and ``soak.json``, as ``benchmarks.soak`` does, and writes ``reliability.md``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.soak import ENDINGS, summary
from morlnav.record.markdown import markdown_table


def kills_page(rows: Iterable[Mapping[str, Any]]) -> str:
    """How many kills went on to the same result, by the stage that they hit.

    >>> print(kills_page([{"stage": "audit", "wrong": ""}, {"stage": "audit", "wrong": "policy.pt"}]))
    1 of 2 killed trainings went on to the same result.
    <BLANKLINE>
    | killed in | trials | the same, bit for bit |
    | :-- | --: | --: |
    | audit | 2 | 1 |
    """
    trials = pd.DataFrame(rows)
    trials["right"] = trials["wrong"] == ""
    by_stage = trials.groupby("stage", sort=False)["right"].agg(["size", "sum"]).reset_index()
    table = markdown_table(["killed in", "trials", "the same, bit for bit"], by_stage.to_numpy(), (":--", "--:"))
    return f"{trials['right'].sum()} of {len(trials)} killed trainings went on to the same result.\n\n{table}"


def soak_page(table: pd.DataFrame, ended: Mapping[str, Any]) -> str:
    """Memory and speed over hours, and what short trainings left behind."""
    facts = {
        "hours": "{hours:.2f}",
        "processes that wanted a core, ours among them": "{load:.1f}",
        "MB in the second and in the last quarter": "{rss_second:.0f} and {rss_last:.0f}",
        "growth since the first quarter, when the replay buffer is full, in MB per hour": "{rss_growth:.1f}",
        "frames/s in the second and in the last quarter": "{speed_second:.0f} and {speed_last:.0f}",
    }
    rows = [[name, value.format(**summary(table))] for name, value in facts.items()]
    for how in (how for how in ENDINGS if how in ended):
        left = f"{ended[how]['orphans']} and {len(ended[how]['shm'])}"
        rows.append([f"processes and files of shared memory left after: {how}", left])
    return markdown_table(["a training for hours, and three short ones", ""], rows, (":--", "--:"))


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reliability", description=__doc__.split("\n", 1)[0])
    parser.add_argument("folder", type=Path, nargs="?", default=Path("results/reliability"))
    folder = parser.parse_args().folder
    kills = [row for file in sorted(folder.glob("kills_*.json")) for row in json.loads(file.read_text())]
    ended = json.loads((folder / "soak.json").read_text())
    pages = [kills_page(kills), soak_page(pd.read_csv(folder / "soak.csv"), ended)]
    (folder / "reliability.md").write_text("\n\n".join(pages) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
