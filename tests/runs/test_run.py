"""A run directory is read as what it is, or refused in one sentence."""

import shutil

import pytest
import torch
from omegaconf import OmegaConf

from morlnav.runs import Run


@pytest.fixture
def copied(smoke_run, tmp_path):
    """What of a run is read, to be changed by the test."""
    for name in ("config.yaml", "policy.pt", "policy.json"):
        shutil.copy(smoke_run / name, tmp_path)
    return tmp_path


def change(directory, key, value):
    config = OmegaConf.load(directory / "config.yaml")
    OmegaConf.update(config, key, value, force_add=True)
    OmegaConf.save(config, directory / "config.yaml")


def test_a_run_gives_its_policy_and_what_measures_it(copied):
    run = Run(copied, changes={"episodes": 3, "steps": None})
    assert run.policy.objectives == run.evaluation.objectives == ("distance", "efficiency")
    assert (run.evaluation.episodes, run.evaluation.steps) == (3, 2)
    assert run.learned == {}
    assert run.policy(torch.zeros(34), torch.tensor([0.5, 0.5])).shape == (2,)


def test_a_run_is_read_for_another_device_than_it_was_trained_on(copied):
    change(copied, "device", "cuda")
    run = Run(copied)
    assert run.training.device == "cpu"
    assert run.evaluation.env.device == torch.device("cpu")


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("logger._target_", "os.system", r"foreign os\.system; if it is your own, trust it \(--trust, or trust=True\)"),
        ("env.num_envs", "${oc.env:HOME}", "holds no interpolation"),
        ("loss", "wrong", "loss must be a node"),
        ("trainer.totl_frames", 5, r"trainer\.totl_frames is no argument of .*; did you mean total_frames\?"),
    ],
)
def test_a_config_that_no_run_leaves_is_refused_in_one_sentence(key, value, sentence, copied):
    change(copied, key, value)
    with pytest.raises(ValueError, match=sentence) as error:
        _ = Run(copied).training
    assert "\n" not in str(error.value)


def test_a_run_of_an_older_version_is_named(copied):
    config = OmegaConf.load(copied / "config.yaml")
    del config["_target_"]
    OmegaConf.save(config, copied / "config.yaml")
    with pytest.raises(ValueError, match=r"was made by morlnav 0\.1; .* train it again"):
        Run(copied)


def test_what_is_no_run_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"is not a run directory: it holds no config\.yaml"):
        Run(tmp_path)
    (tmp_path / "config.yaml").write_text("{")
    with pytest.raises(ValueError, match=r"config\.yaml is damaged: it is no YAML"):
        Run(tmp_path)
