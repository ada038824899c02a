"""Modules: networks, exploration, the preference interpolator and reward models."""

from typing import Any

from morlnav.modules.interpolator import PreferenceInterpolator
from morlnav.modules.networks import Actor, Flat, Perceptron, VectorCritic, round_products
from morlnav.modules.reward_model import NormalisedReward, RewardEnsemble, RewardModel
from morlnav.modules.saved import load_module, load_weights, read_facts, save_module, write_facts

_NOISE = ("EpsilonGreedyNoise", "PartlyGreedyNoise", "UniformActions")

__all__ = [
    "Actor",
    "EpsilonGreedyNoise",
    "Flat",
    "NormalisedReward",
    "PartlyGreedyNoise",
    "Perceptron",
    "PreferenceInterpolator",
    "RewardEnsemble",
    "RewardModel",
    "UniformActions",
    "VectorCritic",
    "load_module",
    "load_weights",
    "read_facts",
    "round_products",
    "save_module",
    "write_facts",
]


def __getattr__(name: str) -> Any:
    """Exploration stands on TorchRL, which a robot that loads a policy does without."""
    if name in _NOISE:
        from morlnav.modules import noise

        return getattr(noise, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
