"""Transforms of environments and replay buffers."""

from morlnav.transforms.demonstration_reward import DemonstrationReward
from morlnav.transforms.preference import DrawPreference
from morlnav.transforms.relabel import HindsightPreferenceRelabel
from morlnav.transforms.reward_vector import RewardVector, transforms_of
from morlnav.transforms.scale import ScaleReward

__all__ = [
    "DemonstrationReward",
    "DrawPreference",
    "HindsightPreferenceRelabel",
    "RewardVector",
    "ScaleReward",
    "transforms_of",
]
