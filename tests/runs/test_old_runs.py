"""A run of morlnav 0.1 is refused by name of that version, by every command, and stays as it is."""

import json
import sys

import pytest
import torch
import yaml

import morlnav
from morlnav.analysis import load_sweep
from morlnav.commands import audit, evaluate
from morlnav.deployment import export

SENTENCE = r"was made by morlnav 0\.1"
ACTOR = {"low": torch.tensor([0.0, -3.0]), "high": torch.tensor([0.5, 3.0]), "mlp.0.weight": torch.zeros(2, 71)}
REWARD = {"class": "RewardModel", "inputs": ["observation"], "features": {"use_lidar": False}, "depth": 3}


@pytest.fixture
def old_run(tmp_path):
    """As version 0.1 left it, with what is of no matter here cut short."""
    directory = tmp_path / "old"
    checkpoint = directory / "checkpoints" / "checkpoint-000000000512"
    for folder in (checkpoint, directory / ".hydra", directory / "logs" / "scalars" / "train"):
        folder.mkdir(parents=True)
    config = {
        "world": {"_target_": "morlnav.world.TensorWorld", "step_time": 0.2},
        "env": {"num_envs": 128, "max_steps": 250},
        "objectives": {"demo": {"_target_": "morlnav.envs.DemonstrationObjective", "reward": {"path": "reward.pt"}}},
        "networks": {"actor": {"_target_": "morlnav.modules.Actor", "depth": 0}},
        "loss": {"_target_": "morlnav.objectives.MORLTD3Loss", "gamma": 0.99, "angle": "safe"},
        "evaluation": {"episodes": 100, "during": {"interval": 40000}},
        "seed": 0,
        "resume": None,
    }
    (directory / "config.yaml").write_text(yaml.safe_dump(config))
    (directory / ".hydra" / "overrides.yaml").write_text("- loss.gamma=0.99\n- evaluation.during.interval=40000\n")
    (checkpoint / "manifest.json").write_text('{"schema": "torchrl.checkpoint"}')
    (directory / "logs" / "scalars" / "train" / "success.csv").write_text("10,0.5\n")
    torch.save(ACTOR, directory / "policy.pt")
    torch.save({}, directory / "reward.pt")
    (directory / "reward.json").write_text(json.dumps({"inputs": ["observation"], "model": REWARD, "facts": {}}))
    return directory


@pytest.fixture
def unchanged(old_run):
    """That no command changes a byte, or leaves anything."""
    before = contents(old_run)
    yield
    assert contents(old_run) == before


def contents(directory):
    return {path: path.read_bytes() if path.is_file() else None for path in directory.rglob("*")}


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize("main", [evaluate.main, audit.main, export.main], ids=["evaluate", "audit", "export"])
def test_no_command_reads_it(main, old_run, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["morlnav", str(old_run)])
    with pytest.raises(SystemExit, match=SENTENCE) as error:
        main()
    assert "\n" not in error.value.code


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize("words", [[], ["trust=true"], ["trainer.total_frames=9"]], ids=str)
@pytest.mark.parametrize("place", ["", "checkpoints/checkpoint-000000000512"])
def test_training_does_not_go_on_from_it(words, place, old_run, train_command, tmp_path):
    with pytest.raises(SystemExit, match=SENTENCE):
        train_command(f"resume={old_run / place}", *words)
    assert list(tmp_path.iterdir()) == [old_run]


@pytest.mark.usefixtures("unchanged")
def test_training_does_not_begin_in_its_directory(old_run, train_command):
    with pytest.raises(SystemExit, match="holds a run of another config"):
        train_command("trainer=smoke", "recipe=analytical", f"hydra.run.dir={old_run}")


@pytest.mark.usefixtures("unchanged")
def test_its_policy_does_not_load(old_run):
    with pytest.raises(ValueError, match=SENTENCE):
        morlnav.load(old_run)


def test_its_reward_alone_is_refused_too(old_run):
    (old_run / "config.yaml").unlink()
    with pytest.raises(ValueError, match=rf"reward\.json {SENTENCE}"):
        audit.audit(old_run)


@pytest.mark.usefixtures("unchanged")
def test_its_logs_are_still_read(old_run):
    assert load_sweep(old_run)["value"].tolist() == [0.5]
