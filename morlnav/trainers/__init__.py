"""Training: the parts' wiring, the optimisation step, hooks for TorchRL's trainer, and learning from demonstrations."""

from morlnav.trainers.divergence import StopDivergence
from morlnav.trainers.drex import DREX, LearnedReward
from morlnav.trainers.hooks import AnnealDiscount, EvaluatePolicy, LogEpisodes, LogOptimisation, StepExploration
from morlnav.trainers.interpolation import FitInterpolator
from morlnav.trainers.live import live_objects
from morlnav.trainers.refinement import PathwiseRefinement
from morlnav.trainers.stages import Cloning, Demonstrations, Ranking
from morlnav.trainers.stepper import MORLTD3Stepper, linear_decay
from morlnav.trainers.supervised import Fit
from morlnav.trainers.trainer import MORLTrainer
from morlnav.trainers.training import Training

__all__ = [
    "DREX",
    "AnnealDiscount",
    "Cloning",
    "Demonstrations",
    "EvaluatePolicy",
    "Fit",
    "FitInterpolator",
    "LearnedReward",
    "LogEpisodes",
    "LogOptimisation",
    "MORLTD3Stepper",
    "MORLTrainer",
    "PathwiseRefinement",
    "Ranking",
    "StepExploration",
    "StopDivergence",
    "Training",
    "linear_decay",
    "live_objects",
]
