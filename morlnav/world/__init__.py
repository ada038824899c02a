"""The world: scenes, kinematics, lidar and contact. No reinforcement learning in this room."""

from morlnav.world.base import Contact, World, without_human
from morlnav.world.kinematics import DifferentialDrive
from morlnav.world.lidar import Lidar
from morlnav.world.pymunk import PymunkWorld
from morlnav.world.scene import Scene, SceneSampler
from morlnav.world.tensor import TensorWorld

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
