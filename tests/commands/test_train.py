"""Whole trainings in seconds: every file is left behind, mistakes read well, and whoever is interrupted goes on."""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
import torch
from omegaconf import OmegaConf
from support import ANALYTICAL, SMALL, assert_identical, configure

import morlnav
from morlnav.cli import conf_dir, one_sentence_errors
from morlnav.commands.evaluate import evaluate_run
from morlnav.commands.train import run
from morlnav.runs import Run
from morlnav.trainers import PathwiseRefinement, Training
from morlnav.trainers.checkpoint import find_checkpoints


def test_a_run_leaves_everything_behind(smoke_run):
    files = ["config.yaml", "policy.pt", "policy.json", "versions.json", "times.json"]
    files += ["evaluation/table.md", "evaluation/trajectories.png"]
    files += [f"evaluation/{name}.csv" for name in ("episodes", "summary", "fidelity", "front")]
    for name in files:
        assert (smoke_run / name).stat().st_size > 0, name
    assert torch.__version__.startswith(json.loads((smoke_run / "versions.json").read_text())["torch"])
    assert len(list((smoke_run / "checkpoints").glob("checkpoint-*"))) == 2
    assert list((smoke_run / "logs").rglob("events.out.tfevents.*"))


def test_logged_losses_are_finite_and_episodes_are_counted(smoke_run):
    scalars = {path.stem: path for path in (smoke_run / "logs").rglob("*.csv")}
    assert {"loss_qvalue", "loss_actor", "gamma", "lr_actor", "expected_utility", "key_utility"} <= scalars.keys()
    assert {"return_distance", "return_scalarised", "episode_length", "timeout"} <= scalars.keys()
    for name in ("loss_qvalue", "loss_actor", "pred_value_distance", "grad_norm_actor", "angle_actor"):
        table = pd.read_csv(scalars[name], header=None, names=["step", "value"])
        assert len(table) >= 3, name
        assert table.value.map(math.isfinite).all(), name
        assert table.step.is_monotonic_increasing, name
        assert table.step.iloc[-1] <= 512, name


def test_a_finished_run_can_be_measured_again_elsewhere(smoke_run, tmp_path):
    output = evaluate_run(Run(smoke_run, changes={"episodes": 2, "steps": 1}), tmp_path)
    assert output == tmp_path
    assert "4 episodes: 2 preferences in 2 scenes" in (tmp_path / "table.md").read_text()
    assert len(pd.read_csv(tmp_path / "episodes.csv")) == 4


def test_a_single_objective_runs_to_the_end(tmp_path):
    brief = ("trainer.total_frames=32", "collector.init_random_frames=16")
    finished = run(configure(*brief, "objectives=[baseline,distance]"), tmp_path)
    assert (tmp_path / "evaluation" / "table.md").read_text().startswith("| distance | SR % |")
    assert finished.policy.objectives == morlnav.load(tmp_path).objectives == ("distance",)


# Interrupted runs


def test_ctrl_c_says_how_to_go_on_and_going_on_loses_nothing(smoke_run, tmp_path, monkeypatch, capsys):
    make_trainer = Training.make_trainer

    def interrupted_trainer(*args):
        trainer = make_trainer(*args)
        trainer.register_op(
            "post_steps", lambda: os.kill(os.getpid(), signal.SIGINT) if trainer.collected_frames == 208 else None
        )
        return trainer

    monkeypatch.setattr(Training, "make_trainer", interrupted_trainer)
    assert run(configure(), tmp_path) is None
    assert "Stopped after 208 frames" in (text := capsys.readouterr().out)
    assert f"morlnav-train resume={tmp_path}" in text
    assert not (tmp_path / "policy.pt").exists()

    monkeypatch.undo()
    run(configure(f"resume='{tmp_path}'"), tmp_path)
    assert "at 208 of 512 frames" in capsys.readouterr().out
    assert_identical(torch.load(tmp_path / "policy.pt"), torch.load(smoke_run / "policy.pt"))


def test_ctrl_c_in_the_refinement_says_how_to_go_on_and_going_on_gives_the_same(
    smoke_run, tmp_path, monkeypatch, capsys
):
    def interrupted(self, actor, gamma):
        raise KeyboardInterrupt

    monkeypatch.setattr(PathwiseRefinement, "_drive", interrupted)
    assert run(configure(), tmp_path) is None
    assert (
        f"Stopped in the refinement, which begins anew with: morlnav-train resume={tmp_path}" in capsys.readouterr().out
    )
    assert not (tmp_path / "policy.pt").exists()

    monkeypatch.undo()
    assert run(configure(f"resume='{tmp_path}'"), tmp_path) is not None
    assert_identical(torch.load(tmp_path / "policy.pt"), torch.load(smoke_run / "policy.pt"))


@pytest.mark.parametrize("number", ["SIGTERM", "SIGHUP"])
def test_whatever_asks_a_training_to_end_gets_a_checkpoint(number, tmp_path, monkeypatch):
    number, make_trainer = getattr(signal, number), Training.make_trainer

    def asked_trainer(*args):
        trainer = make_trainer(*args)
        trainer.register_op("post_steps", lambda: os.kill(os.getpid(), number))
        return trainer

    monkeypatch.setattr(Training, "make_trainer", asked_trainer)
    brief = configure("trainer.total_frames=48", "collector.init_random_frames=16")
    assert run(brief, tmp_path / "asked") is None
    assert [path.name for path in find_checkpoints(tmp_path / "asked")] == ["checkpoint-000000000016"]
    if number == signal.SIGHUP:
        before = signal.signal(number, signal.SIG_IGN)  # as nohup does
        try:
            assert run(brief, tmp_path / "deaf") is not None
        finally:
            signal.signal(number, before)


def test_a_killed_run_goes_on_from_its_last_checkpoint_to_the_same_policy(smoke_run, train_command, tmp_path, capsys):
    directory = tmp_path / "0_seed=0,world=tensor"  # named as a sweep names its runs
    mine = tmp_path / "my_conf" / "preferences" / "mine.yaml"
    mine.parent.mkdir(parents=True)
    shutil.copy(Path(conf_dir()) / "preferences" / "corners.yaml", mine)
    command = [sys.executable, "-m", "morlnav.commands.train", "--config-dir", str(tmp_path / "my_conf")]
    words = ["preferences=mine", *SMALL, ANALYTICAL, f"hydra.run.dir='{directory}'"]
    process = subprocess.Popen([*command, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        for _ in range(12000):
            if directory.is_dir() and list((directory / "checkpoints").glob("checkpoint-*/manifest.json")):
                break
            assert process.poll() is None, process.communicate()[1]
            time.sleep(0.05)
    finally:
        process.kill()
        process.communicate()
    assert not (directory / "policy.pt").exists()

    began = OmegaConf.load(directory / "config.yaml")
    other = OmegaConf.merge(began, {"loss": {"policy_noise": 0.7}})
    del other.loss.terms.proposals.search
    OmegaConf.save(other, directory / "config.yaml")
    changed = r"loss.policy_noise: 0.7 then, 0.1 now; loss.terms.proposals.search.*: nothing then"
    with pytest.raises(SystemExit, match=changed):
        train_command(f"resume={directory}")
    del began.compile  # of a version that knew no such part, which is none now
    OmegaConf.save(began, directory / "config.yaml")

    versions = json.loads((directory / "versions.json").read_text())
    (directory / "versions.json").write_text(json.dumps(versions | {"git": "another"}))
    train_command(f"resume={directory}")
    assert json.loads((directory / "versions.json").read_text()) == versions | {"git": "another", "resumed": [versions]}
    assert "Continuing from" in capsys.readouterr().out
    assert_identical(torch.load(directory / "policy.pt"), torch.load(smoke_run / "policy.pt"))


@pytest.mark.parametrize("path", ["nowhere", "."])
def test_resuming_from_a_place_without_checkpoints_says_so(path, tmp_path):
    with pytest.raises(FileNotFoundError, match="no checkpoint there; give a run directory"):
        run(configure(f"resume='{tmp_path / path}'"), tmp_path)


# Mistakes; tests/config/test_wrong.py has a table of them


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("+trainer.totl_frames=3", r"trainer\.totl_frames is no argument of .*; did you mean total_frames\?"),
        (
            "objectives=[distance,baseline]",
            "Static objectives must come before tuneable ones",
        ),  # only its class can tell
        ("hooks.discount.start=0.999", r"hooks\.discount.* 0 <= start <= end <= 1"),  # built last of all
    ],
)
def test_a_mistake_is_one_sentence_and_leaves_no_directory(override, sentence, tmp_path):
    with pytest.raises(SystemExit, match=sentence) as error, one_sentence_errors():
        run(configure(override), tmp_path / "run")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("world=nosuch", ["There is no world/nosuch; choose from: pymunk, ", "tensor"]),
        ("nosuch=3", ["There is no nosuch in the config; choose from: rewards, "]),
        ("resume=nowhere", ["resume=nowhere: no run of morlnav-train there."]),
    ],
)
def test_the_command_line_names_a_mistake_and_the_choices(override, words, train_command, tmp_path, capfd):
    with pytest.raises(SystemExit) as error:
        train_command(*SMALL, f"hydra.run.dir='{tmp_path}'", override)
    assert error.value.code not in (0, None)
    text = capfd.readouterr().err + str(error.value)
    assert "Traceback" not in text
    for word in words:
        assert word in text
