"""The world: scenes, kinematics, lidar and contact. No reinforcement learning in this room."""

from typing import TYPE_CHECKING, Any

from morlnav.navigation.world.base import Contact, World, without_human
from morlnav.navigation.world.kinematics import DifferentialDrive
from morlnav.navigation.world.lidar import Lidar
from morlnav.navigation.world.scene import Scene, SceneSampler
from morlnav.navigation.world.tensor import TensorWorld

if TYPE_CHECKING:
    from morlnav.navigation.world.pymunk import PymunkWorld

__all__ = [
    "Contact",
    "DifferentialDrive",
    "Lidar",
    "PymunkWorld",
    "Scene",
    "SceneSampler",
    "TensorWorld",
    "World",
    "without_human",
]


def __getattr__(name: str) -> Any:
    """Only who asks for it waits for pymunk."""
    if name == "PymunkWorld":
        from morlnav.navigation.world.pymunk import PymunkWorld

        return PymunkWorld
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
