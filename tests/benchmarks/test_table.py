"""Medians, quartiles and ratios against numbers worked out by hand."""

import numpy as np
import pandas as pd

from benchmarks.table import markdown, tabulate, write
from benchmarks.timing import Row

OURS = Row("speed", "batch 1", "ours", "1/s", [8.0, 20.0, 10.0], size=1)
PEER = Row("speed", "batch 1", "peer", "1/s", [4.0, 4.0, 2.0], size=1)
MISSING = Row("speed", "batch 1", "absent", "1/s", note="missing: No module named 'absent'", size=1)
HEADINGS = {"speed": ("Speed", "What\nit means."), "memory": ("Memory", "Bytes.")}


def test_ratios_are_taken_within_the_rounds():
    table = tabulate([OURS, PEER, MISSING])
    assert table["median"].tolist()[:2] == [10.0, 4.0]
    assert (table["q1"][0], table["q3"][0]) == (9.0, 15.0)
    assert table["ratio"].tolist()[:2] == [1.0, 5.0]  # of 2, 5 and 5; the medians' ratio would be 2.5


def test_less_is_better_for_bytes():
    rows = [
        Row("memory", "c", name, "bytes", [size], less_is_better=True) for name, size in (("ours", 100), ("a", 250))
    ]
    assert tabulate(rows)["ratio"].tolist() == [1.0, 2.5]


def test_every_case_and_unit_has_its_own_reference():
    other = Row("speed", "batch 2", "ours", "1/s", [3.0])
    assert tabulate([OURS, PEER, other])["ratio"].tolist() == [1.0, 5.0, 1.0]


def test_a_missing_peer_has_no_number():
    table = tabulate([OURS, MISSING])
    assert np.isnan(table["median"][1])
    assert np.isnan(table["ratio"][1])
    line = markdown(table, HEADINGS, "Measured here.").splitlines()[-1]
    assert line == "| batch 1 | absent | – | – | 1/s | – | missing: No module named 'absent' |"


def test_table_csv_and_plot_are_written(tmp_path):
    larger = Row("speed", "batch 2", "ours", "1/s", [3.0], size=2)
    text = write([OURS, PEER, MISSING, larger, Row("memory", "c", "ours", "bytes", [9.0])], tmp_path, HEADINGS, "Here.")
    assert "| batch 1 | peer | 4 | 3 … 4 | 1/s | 5.00 |  |" in text
    assert (tmp_path / "benchmarks.md").read_text(encoding="utf-8") == text
    assert len(pd.read_csv(tmp_path / "benchmarks.csv")) == 5
    assert (tmp_path / "benchmarks.png").stat().st_size > 1000
