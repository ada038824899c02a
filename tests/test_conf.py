"""The config groups serve other projects."""

import os
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from morlnav.cli import conf_dir

CHECKOUT = Path(__file__).parents[1]
APP = """
import sys

import hydra
import morlnav
from omegaconf import OmegaConf

@hydra.main(version_base="1.3", config_path=".", config_name="app")
def main(cfg):
    OmegaConf.save(cfg, "composed.yaml")
    print(morlnav.__file__)
    assert "matplotlib" not in sys.modules, "who only takes parts should not wait for what draws"

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


def unpacked_wheel(directory):
    """The package as others install it."""
    pytest.importorskip("hatchling", reason="hatchling builds the wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(directory)]
    subprocess.run(build, cwd=CHECKOUT, capture_output=True, check=True)
    (wheel,) = directory.glob("*.whl")
    with ZipFile(wheel) as file:
        file.extractall(directory)
    return directory


def configs(directory):
    return {path.relative_to(directory) for path in directory.rglob("*.yaml")}


@pytest.mark.parametrize("installed", ["checkout", "wheel"])
def test_another_project_composes_our_groups_under_its_own_names(installed, tmp_path):
    package = unpacked_wheel(tmp_path / "wheel") if installed == "wheel" else CHECKOUT
    (tmp_path / "app.py").write_text(APP)
    (tmp_path / "app.yaml").write_text(CONFIG)
    overrides = ["my.loss.angle=none", "preferences@my.sampler=dirichlet"]
    command = [sys.executable, "-W", "error::UserWarning", "app.py", *overrides]  # Hydra warns of a missing package
    environment = os.environ | {"PYTHONPATH": str(package)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    imported = Path(done.stdout.strip()).parent
    assert imported == package / "morlnav"
    assert configs(imported / "conf") == configs(CHECKOUT / "conf")
    mine = OmegaConf.load(tmp_path / "composed.yaml").my
    assert mine.loss._target_ == "morlnav.objectives.MORLTD3Loss"
    assert (mine.loss.gamma, mine.loss.angle) == (0.9, "none")
    assert mine.sampler._target_ == "morlnav.data.DirichletPreferences"


@pytest.mark.parametrize("recipe", ["recommended", "analytical", "paper"])
def test_every_recipe_can_be_tried_in_seconds(recipe):
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        assert compose("train", [f"recipe={recipe}", "trainer=smoke"]).trainer.total_frames == 512


def test_the_papers_recipe_trains_on_a_reward_that_fails_its_audit():
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        cfgs = [compose("train", [f"recipe={recipe}"]) for recipe in ("paper", "recommended")]
    assert [cfg.audit.required for cfg in cfgs] == [False, True]
