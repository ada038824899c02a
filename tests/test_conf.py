"""The config groups serve other projects."""

import subprocess
import sys

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from morlnav.cli import conf_dir

APP = """
import hydra
from omegaconf import OmegaConf

@hydra.main(version_base="1.3", config_path=".", config_name="app")
def main(cfg):
    OmegaConf.save(cfg, "composed.yaml")

main()
"""
CONFIG = """
defaults:
  - loss@my.loss: morl_td3
  - preferences@my.sampler: corners
  - _self_
my: {loss: {gamma: 0.9}}
hydra:
  searchpath: [pkg://morlnav.conf]
  run: {dir: .}
"""


def test_another_project_composes_our_groups_under_its_own_names(tmp_path):
    (tmp_path / "app.py").write_text(APP)
    (tmp_path / "app.yaml").write_text(CONFIG)
    overrides = ["my.loss.angle=none", "preferences@my.sampler=dirichlet"]
    command = [sys.executable, "-W", "error::UserWarning", "app.py", *overrides]  # Hydra warns of a missing package
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    mine = OmegaConf.load(tmp_path / "composed.yaml").my
    assert mine.loss._target_ == "morlnav.objectives.MORLTD3Loss"
    assert (mine.loss.gamma, mine.loss.angle) == (0.9, "none")
    assert mine.sampler._target_ == "morlnav.data.DirichletPreferences"


@pytest.mark.parametrize("recipe", ["recommended", "analytical", "paper"])
def test_every_recipe_can_be_tried_in_seconds(recipe):
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        assert compose("train", [f"recipe={recipe}", "trainer=smoke"]).trainer.total_frames == 512
