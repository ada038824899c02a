"""``morlnav-benchmark --quick``: ours is really measured, and what is not there is said."""

import sys

import pandas as pd
import pytest

from morlnav import benchmark


def test_a_quick_benchmark_measures_ours_and_writes_its_files(tmp_path, monkeypatch, capsys):
    words = ["morlnav-benchmark", "--quick", "--threads", "2", "--output", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    benchmark.main()
    table = pd.read_csv(tmp_path / "benchmarks.csv")
    cpu = table[table["case"] != "cuda"]
    assert set(cpu["group"]) == set(benchmark.GROUPS)
    assert (cpu.loc[cpu["rounds"] > 0, "median"] > 0).all()
    assert {"stacked under vmap", "in processes"} <= set(table["name"])
    unmeasured = table[table["rounds"] == 0]
    assert unmeasured["median"].isna().all()
    assert unmeasured["note"].str.contains("not measured|not available").all()
    assert "## Simulation" in capsys.readouterr().out
    assert {file.name for file in tmp_path.iterdir()} == {"benchmarks.csv", "benchmarks.md", "benchmarks.png"}


def test_an_unknown_group_is_refused_in_one_sentence(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["morlnav-benchmark", "speed"])
    with pytest.raises(SystemExit):
        benchmark.main()
    assert "there is no group speed; choose from: simulation, learner" in capsys.readouterr().err
