"""Sweeps by the launchers and sweepers that people use, two jobs each."""

import json
import shutil
import sys
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from support import SINGLE, SMALL, assert_identical

CHECKOUT = Path(__file__).parents[1]
SWEEPS = {
    "basic": ["seed=0,1"],
    "joblib": ["hydra/launcher=joblib", "seed=0,1"],
    "ray": ["hydra/launcher=ray", "+hydra.launcher.ray.init.include_dashboard=false", "seed=0,1"],
    "submitit": ["hydra/launcher=submitit_local", "seed=0,1"],
    "optuna": [
        *("hydra/sweeper=optuna", "hydra.sweeper.n_trials=2", "hydra.sweeper.n_jobs=1"),
        *("hydra.sweeper.direction=maximize", "hooks.discount.end=interval(0.9,0.99)"),
    ],
}
SHORT = (SINGLE, "trainer.total_frames=128", "evaluation.episodes=2", "evaluation.steps=1")


@pytest.mark.parametrize("sweep", SWEEPS)
def test_a_sweep_of_two_jobs(sweep, train_command, tmp_path, monkeypatch):
    if sweep == "ray":
        pytest.importorskip("ray")
    for name, value in {"OMP_NUM_THREADS": "1", "RAY_worker_niceness": "0"}.items():
        monkeypatch.setenv(name, value)
    try:
        train_command("-m", *SMALL, *SHORT, *SWEEPS[sweep])
    finally:
        if "ray" in sys.modules:
            sys.modules["ray"].shutdown()
    runs = sorted(path.parent for path in tmp_path.glob("multirun/*/*/*/config.yaml"))
    assert len(runs) == 2
    for run in runs:
        for file in ("policy.pt", "versions.json", "evaluation/table.md", ".hydra/overrides.yaml"):
            assert (run / file).is_file(), file
        assert ("git" in json.loads((run / "versions.json").read_text())) == (CHECKOUT / ".git").exists()
    if sweep == "optuna":  # what it maximises is the expected utility
        assert isinstance(OmegaConf.load(runs[0].parent / "optimization_results.yaml").best_value, float)
    else:
        assert [OmegaConf.load(run / "config.yaml").seed for run in runs] == [0, 1]


def test_a_sweep_goes_on_where_it_stopped(train_command, tmp_path, capsys):
    sweep = ["-m", "hydra.sweep.dir=sweep", *SMALL, *SHORT, "trainer.checkpoint_interval=64", "seed=0,1"]
    train_command(*sweep)
    finished, half_done = tmp_path / "sweep" / "0", tmp_path / "sweep" / "1"
    before, policy = (finished / "policy.pt").stat().st_mtime_ns, torch.load(half_done / "policy.pt")
    shutil.rmtree(half_done / "evaluation")
    (half_done / "policy.pt").unlink()
    shutil.rmtree(half_done / "checkpoints" / "checkpoint-000000000128")
    capsys.readouterr()

    train_command(*sweep)
    told = capsys.readouterr().out
    assert "sweep/0 has finished with these settings before; nothing is left to do." in told
    assert "checkpoint-000000000080 at 80 of 128 frames" in told
    assert (finished / "policy.pt").stat().st_mtime_ns == before
    assert (half_done / "evaluation" / "table.md").is_file()
    assert_identical(torch.load(half_done / "policy.pt"), policy)

    with pytest.raises(
        SystemExit, match=r"sweep/0 holds a run of another config \(loss\.noise_clip: 0\.5 then, 0\.3 now"
    ):
        train_command(*sweep, "loss.noise_clip=0.3")


def test_a_value_that_a_later_job_is_refused_for_is_told_before_the_first_one_trains(train_command, tmp_path):
    told = r"loss\.noise_clip=-7: loss\.noise_clip must not be negative, got -7\."
    with pytest.raises(SystemExit, match=told):
        train_command("-m", *SMALL, *SHORT, "loss.noise_clip=0.5,-7")
    assert not any(tmp_path.iterdir())
