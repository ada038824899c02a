"""Modules: networks, exploration, the preference interpolator and reward models."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from morlnav.modules.networks import Actor, Flat, Perceptron, VectorCritic, round_products
from morlnav.modules.reward_model import NormalisedReward, RewardEnsemble, RewardModel
from morlnav.modules.saved import load_module, load_weights, read_facts, save_module, write_facts

if TYPE_CHECKING:
    from morlnav.modules.held_noise import HeldNoise
    from morlnav.modules.interpolator import PreferenceInterpolator
    from morlnav.modules.noise import EpsilonGreedyNoise, PartlyGreedyNoise

_HOMES = {
    "EpsilonGreedyNoise": "noise",
    "HeldNoise": "held_noise",
    "PartlyGreedyNoise": "noise",
    "PreferenceInterpolator": "interpolator",
}

__all__ = [
    "Actor",
    "EpsilonGreedyNoise",
    "Flat",
    "HeldNoise",
    "NormalisedReward",
    "PartlyGreedyNoise",
    "Perceptron",
    "PreferenceInterpolator",
    "RewardEnsemble",
    "RewardModel",
    "VectorCritic",
    "load_module",
    "load_weights",
    "read_facts",
    "round_products",
    "save_module",
    "write_facts",
]


def __getattr__(name: str) -> Any:
    """What stands on TorchRL comes when it is asked for: a robot that loads a policy does without."""
    if name in _HOMES:
        return getattr(import_module(f"morlnav.modules.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
