"""Composing configs as the command line does, for several tests."""

from hydra import compose, initialize_config_dir

from morlnav.cli import conf_dir
from morlnav.runs import make_training

ANALYTICAL = "objectives=[baseline,distance,efficiency]"
DEMONSTRATED = "objectives=[baseline,demo,distance,efficiency]"
SMALL = (
    "trainer=smoke",
    "threads=1",
    "trainer.progress_bar=false",
    "actor.num_cells=32",
    "critic.num_cells=32",
    "replay.storage.max_size=4096",
)

BRIEF = (  # episodes and rewards of a run with demonstrations
    "env.scenes.distance=[5,6]",
    "transforms.time_limit.max_steps=100",
    "rewards.num=4",
    "rewards.ranking.episodes=2",
    "rewards.ranking.held_out=0.5",
    "rewards.ranking.members=[[observation],[observation,action]]",
    "rewards.audit.num_scenes=2",
    "evaluation.episodes=2",
    "evaluation.steps=1",
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
