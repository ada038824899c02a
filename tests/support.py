"""Composing configs as the command line does, for several tests."""

import torch
from hydra import compose, initialize_config_dir

from morlnav.cli import conf_dir
from morlnav.record.loggers import TensorboardCSVLogger
from morlnav.trainers import make_trainer

ANALYTICAL = "objectives=[baseline,distance,efficiency]"
SMALL = (
    "trainer=smoke",
    "threads=1",
    "trainer.progress_bar=false",
    "networks.actor.num_cells=32",
    "networks.critic.num_cells=32",
    "replay.capacity=4096",
)

BRIEF = (  # episodes and rewards of a run with demonstrations
    "env.scenes.distance=[5,6]",
    "env.max_steps=100",
    "demonstrations.num=4",
    "demonstrations.num_envs=8",
    "ranking.episodes=2",
    "ranking.members=[[observation],[observation,action]]",
    "audit.scenes=2",
    "evaluation.episodes=2",
    "evaluation.steps=1",
)


def configure(*overrides):
    """The config of ``morlnav-train trainer=smoke OVERRIDES``, small, and without demonstrations unless asked for."""
    if not any(override.startswith("objectives=") for override in overrides):
        overrides = (ANALYTICAL, *overrides)
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        return compose("train", [*SMALL, *overrides])


def trainer_for(cfg, directory):
    """The seeded trainer of a config."""
    torch.manual_seed(cfg.seed)
    return make_trainer(cfg, directory, TensorboardCSVLogger("logs", directory))
