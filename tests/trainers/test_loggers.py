"""Every logger of the config group is one word away, and gets what is logged."""

from pathlib import Path

import pytest
from support import configure

from morlnav.cli import conf_dir
from morlnav.runs import make_training

INSTALLED = {"mlflow": "mlflow", "wandb": "wandb"}
CHOICES = sorted(path.stem for path in (Path(conf_dir()) / "logger").glob("*.yaml"))


@pytest.mark.parametrize("choice", CHOICES)
def test_one_word_chooses_a_logger(choice, tmp_path, monkeypatch):
    if choice in INSTALLED:
        pytest.importorskip(INSTALLED[choice])
    monkeypatch.setenv("WANDB_MODE", "disabled")
    monkeypatch.chdir(tmp_path)
    logger = make_training(configure(f"logger={choice}")).make_logger(tmp_path)
    logger.log_scalar("train/success", 1.0, step=10)


def test_a_rehearsal_starts_no_logger(tmp_path):
    training = make_training(configure("logger=csv"))
    training.rehearse(tmp_path)
    assert not list(tmp_path.iterdir())
