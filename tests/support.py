"""Composing configs as the command line does, for several tests."""

import torch
from hydra import compose, initialize_config_dir

from benchmarks.kills import BRIEF as BRIEF  # of several tests
from morlnav.cli import conf_dir
from morlnav.runs import make_training

ANALYTICAL = "objectives=[baseline,distance,efficiency]"
SINGLE = "objectives=[baseline,distance]"
"""One style, of whose evaluation no figures are drawn: half the time of a whole run in seconds."""
DEMONSTRATED = "objectives=[baseline,demo,distance,efficiency]"
SMALL = (
    "trainer=smoke",
    "threads=1",
    "trainer.progress_bar=false",
    "actor.num_cells=32",
    "critic.num_cells=32",
    "replay.storage.max_size=4096",
    "transforms.time_limit.max_steps=100",
)


def configure(*overrides):
    """The config of ``morlnav-train trainer=smoke OVERRIDES``, small, and without demonstrations unless asked for."""
    if not any(override.startswith("objectives=") for override in overrides):
        overrides = (ANALYTICAL, *overrides)
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        return compose("train", [*SMALL, *overrides])


def trainer_for(cfg, directory, learned=None):
    """The seeded trainer of a config, with the rewards that were learned for it."""
    training = make_training(cfg)
    return training.make_trainer(directory, learned, training.make_logger(directory))


def learned(trainer):
    """Everything that a trainer has learned or will learn from, as nested dictionaries."""
    hooks = ("log_episodes", "log_optimisation", "fit_interpolator", "evaluate")
    return {
        "loss": trainer.loss_module.state_dict(),
        "average": trainer.checkpoint.components["average"].state_dict(),
        "stepper": trainer.optimization_stepper.state_dict(),
        "hooks": {name: trainer._modules[name].state_dict() for name in hooks},
        "replay": trainer.replay_buffer.storage[:].to_dict(),
        "gamma": trainer.loss_module.value_estimator.gamma,
        "frames": trainer.collected_frames,
        "random state": torch.get_rng_state(),
    }


def assert_identical(ours, theirs, name=""):
    """Equal in every bit, however deeply nested."""
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys(), name
        for key in ours:
            assert_identical(ours[key], theirs[key], f"{name}.{key}")
    elif isinstance(ours, list | tuple):
        assert len(ours) == len(theirs), name
        for i, pair in enumerate(zip(ours, theirs, strict=True)):
            assert_identical(*pair, f"{name}[{i}]")
    elif isinstance(ours, torch.Tensor):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=0, equal_nan=True, msg=lambda text: f"{name}: {text}")
    else:
        assert ours == theirs, name
