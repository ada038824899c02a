"""Training: the experiment builder, the optimisation step, and hooks for TorchRL's trainer."""

from morlnav.trainers.builders import make_base_env, make_env, make_loss, make_networks, make_preferences, make_replay
from morlnav.trainers.divergence import StopDivergence
from morlnav.trainers.evaluator import EvaluatePolicy
from morlnav.trainers.experiment import make_trainer
from morlnav.trainers.hooks import AnnealDiscount, LogEpisodes, LogOptimisation, StepExploration
from morlnav.trainers.interpolation import FitInterpolator
from morlnav.trainers.resume import RolloutState
from morlnav.trainers.stepper import MORLTD3Stepper

__all__ = [
    "AnnealDiscount",
    "EvaluatePolicy",
    "FitInterpolator",
    "LogEpisodes",
    "LogOptimisation",
    "MORLTD3Stepper",
    "RolloutState",
    "StepExploration",
    "StopDivergence",
    "make_base_env",
    "make_env",
    "make_loss",
    "make_networks",
    "make_preferences",
    "make_replay",
    "make_trainer",
]
