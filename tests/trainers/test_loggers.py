"""Every logger of the config group is one word away, and gets what is logged."""

import time
from importlib.util import find_spec
from pathlib import Path

import pytest
from support import SINGLE, SMALL, configure
from torchrl.record.loggers import Logger

from morlnav.cli import conf_dir
from morlnav.config import Part, classes
from morlnav.runs import make_training

CHOICES = sorted(path.stem for path in (Path(conf_dir()) / "logger").glob("*.yaml"))
PACKAGES = {"mlflow": "mlflow", "wandb": "wandb"}
"""What a logger needs that is no part of the installation."""

BEHIND = {"tensorboard_csv": ["morlnav.record.loggers.TensorboardCSVLogger"]} | {
    choice: [f"torchrl.record.loggers.{choice}.{name}"]
    for choice, name in {
        "csv": "CSVLogger",
        "tensorboard": "TensorboardLogger",
        "mlflow": "MLFlowLogger",
        "wandb": "WandbLogger",
    }.items()
}


@pytest.mark.parametrize("choice", CHOICES)
def test_one_word_chooses_a_logger_of_torchrl_or_both_of_its_plain_ones(choice):
    logger = make_training(configure(f"logger={choice}")).logger  # its keys are checked against the class
    assert isinstance(logger, Part)
    assert classes(logger) == BEHIND[choice]


@pytest.mark.parametrize("choice", [choice for choice in CHOICES if find_spec(PACKAGES.get(choice, "torchrl"))])
def test_what_is_logged_arrives(choice, tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.chdir(tmp_path)
    logger = make_training(configure(f"logger={choice}")).make_logger(tmp_path)
    assert isinstance(logger, Logger)
    logger.log_scalar("train/success", 1.0, step=10)
    for _ in range(1000):  # TensorBoard writes in a thread of its own
        if any(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file()):
            return
        time.sleep(0.01)
    pytest.fail("Nothing was written.")


@pytest.mark.parametrize("choice", [choice for choice, package in PACKAGES.items() if not find_spec(package)])
def test_a_package_that_a_logger_lacks_is_named_before_anything_runs(choice, train_command, tmp_path):
    with pytest.raises(SystemExit, match=rf"^logger: .*{PACKAGES[choice]}.*$"):
        train_command(*SMALL, SINGLE, f"logger={choice}")
    assert not list(tmp_path.iterdir())


def test_a_rehearsal_starts_no_logger(tmp_path):
    training = make_training(configure("logger=csv"))
    training.rehearse(tmp_path)
    assert not list(tmp_path.iterdir())
