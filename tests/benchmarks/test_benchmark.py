"""``python -m benchmarks --quick``: ours is really measured, and what cannot be is said."""

import pandas as pd
import pytest

from benchmarks import __main__ as benchmark


def test_a_quick_benchmark_measures_ours_and_writes_its_files(tmp_path, capsys):
    benchmark.main(["--quick", "--threads", "2", "--output", str(tmp_path)])
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


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["speed"], "There is no group speed; choose from: simulation, learner"),
        (["--rounds", "0"], "Needed are rounds >= 1, .* got 0"),
        (["--batches", "64", "0"], "Needed are .* batches >= 1, got .* 64, 0"),
        (["--seconds", "-1"], "Needed are .* seconds >= 0"),
        (["--seconds", "nan"], "Needed are .* seconds >= 0"),
        (["--threads", "0"], "threads must be from 1 to 1024, got 0"),
        (["--device", "tpus"], "There is no device tpus"),
        (["--runs", "nowhere"], "nowhere is not a run directory"),
    ],
)
def test_what_cannot_be_measured_is_refused_in_one_sentence(words, sentence, tmp_path):
    with pytest.raises(SystemExit, match=sentence):
        benchmark.main([*words, "--output", str(tmp_path)])
    assert not list(tmp_path.iterdir())
