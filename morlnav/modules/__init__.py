"""Modules: networks, the preference interpolator and the reward model."""

from morlnav.modules.afterstate import AfterstateFeatures
from morlnav.modules.interpolator import PreferenceInterpolator
from morlnav.modules.networks import Actor, NavigationFeatures, VectorCritic, round_products
from morlnav.modules.noise import EpsilonGreedyNoise, PartlyGreedyNoise, UniformActions, WanderingNoise
from morlnav.modules.oracle import CircumnavigationOracle, Oracle, Plan
from morlnav.modules.passing import PassingOracle, SlowPassingOracle, WaitingOracle
from morlnav.modules.reward_file import load_reward, load_weights, read_facts, save_reward, write_facts
from morlnav.modules.reward_model import NormalisedReward, RewardEnsemble, RewardModel
from morlnav.modules.weights import check_weights

__all__ = [
    "Actor",
    "AfterstateFeatures",
    "CircumnavigationOracle",
    "EpsilonGreedyNoise",
    "NavigationFeatures",
    "NormalisedReward",
    "Oracle",
    "PartlyGreedyNoise",
    "PassingOracle",
    "Plan",
    "PreferenceInterpolator",
    "RewardEnsemble",
    "RewardModel",
    "SlowPassingOracle",
    "UniformActions",
    "VectorCritic",
    "WaitingOracle",
    "WanderingNoise",
    "check_weights",
    "load_reward",
    "load_weights",
    "read_facts",
    "round_products",
    "save_reward",
    "write_facts",
]
