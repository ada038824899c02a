"""The interface that both physics engines implement."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import torch
from tensordict import tensorclass
from torch import Tensor

from morlnav.limits import check_positive
from morlnav.navigation.world.geometry import distance_to_box, polar
from morlnav.navigation.world.kinematics import DifferentialDrive, Robot
from morlnav.navigation.world.lidar import Lidar
from morlnav.navigation.world.scene import Scene


@tensorclass
class Contact:
    """What the robot met during one control step; ``bool`` of shape ``[B]``, but for the time.

    ``duration`` is how long the robot drove in seconds ``[B]``, up to the contact; the whole step where it is ``None``.
    """

    human: Tensor
    box: Tensor
    goal: Tensor
    duration: Tensor | None = None


class World(ABC):
    """Robots in a batch of scenes: positions, motion, contact and lidar; no word of reinforcement learning.

    Args:
        robot: kinematics and size of the robot.
        lidar: the range scanner.
        human_radius: in metres.
        goal_radius: the goal counts as reached within this distance in metres.
        step_time: one control step in seconds (5 Hz).
        check_interval: contact and goal are checked at least this often, in seconds.
        device: where the tensors live.

    Raises:
        ValueError: if a radius or a time is not positive, or contacts would be checked less than once a step.
    """

    def __init__(
        self,
        robot: Robot | None = None,
        lidar: Lidar | None = None,
        human_radius: float = 0.3,
        goal_radius: float = 0.35,
        step_time: float = 0.2,
        check_interval: float = 0.05,
        device: torch.device | str | None = None,
    ) -> None:
        check_positive(human_radius=human_radius, goal_radius=goal_radius)
        check_positive(step_time=step_time, check_interval=check_interval)
        if check_interval > step_time:
            raise ValueError(f"check_interval must be at most the step_time of {step_time} s, got {check_interval}.")
        self.robot = robot or DifferentialDrive()
        self.lidar = lidar or Lidar()
        self.human_radius = human_radius
        self.goal_radius = goal_radius
        self.step_time = step_time
        self.substeps = math.ceil(step_time / check_interval - 1e-9)
        self.device = torch.device(device) if device is not None else torch.device("cpu")
        self.scene: Scene | None = None
        self.pose: Tensor | None = None

    @property
    def settings(self) -> dict[str, float | str]:
        """What decides how a drive goes and what is seen on it, by the name of its key in a config.

        >>> from morlnav.navigation.world import TensorWorld
        >>> TensorWorld().settings["robot.max_speed"]
        0.5
        """
        parts = {"robot": self.robot, "lidar": self.lidar}
        inner = {f"{part}.{name}": value for part, owner in parts.items() for name, value in vars(owner).items()}
        own = {name: getattr(self, name) for name in ("step_time", "human_radius", "goal_radius")}
        kinds = {part: type(owner).__name__ for part, owner in parts.items()}
        return own | kinds | {name: value for name, value in inner.items() if isinstance(value, int | float | str)}

    def to(self, device: torch.device | str) -> World:
        """Move to a device; the next reset has to be a full one."""
        self.device = torch.device(device)
        self.scene = self.pose = None
        return self

    def reset(self, scene: Scene, mask: Tensor | None = None) -> None:
        """Put the robots at their starts.

        Args:
            scene: scenes for all ``B`` slots.
            mask: ``bool`` ``[B]``; only these slots take their new scene, the others go on. ``None``: all.

        Raises:
            ValueError: if a scene of a full reset is impossible (partial resets, which sampled scenes come in by all
                the time, are not checked), or if a partial reset changes the number of boxes.
        """
        everywhere = mask is None or self.scene is None
        if everywhere:
            scene.check(self.robot.radius, self.human_radius)  # where it is: often the CPU, and nothing waits for a GPU
        scene = scene.to(self.device)
        if everywhere:
            self.scene, self.pose = scene, scene.start.clone()
        elif scene.boxes.shape != self.scene.boxes.shape:
            raise ValueError(
                f"A partial reset cannot change the boxes' shape from {tuple(self.scene.boxes.shape)} to "
                f"{tuple(scene.boxes.shape)}; reset all slots, or keep the number of boxes."
            )
        else:
            self.scene = scene.where(mask, self.scene)
            self.pose = torch.where(mask[:, None], scene.start, self.pose)

    def observe(self) -> Tensor:
        """The raw observation: goal and human in polar coordinates, then the pooled scan, ``[B, 4 + sectors]``."""
        goal, human = polar(self.scene.goal, self.pose), polar(self.scene.human, self.pose)
        return torch.cat([goal, human, self.scan()], -1)

    def clearance(self) -> Tensor:
        """How far a robot's edge is from the human or the nearest box in metres ``[B]``; negative inside."""
        point = self.pose[:, :2]
        human = torch.linalg.vector_norm(point - self.scene.human, dim=-1, keepdim=True) - self.human_radius
        boxes = distance_to_box(point.unsqueeze(1), self.scene.boxes)
        return torch.cat([human, boxes], 1).amin(1) - self.robot.radius

    def path(self, action: Tensor) -> Tensor:
        """The check points of the arc that ``action`` ``[B, 2]`` drives in one control step, ``[B, substeps, 3]``."""
        times = torch.arange(1, self.substeps + 1, device=self.device) * (self.step_time / self.substeps)
        return self.robot.move(self.pose.unsqueeze(1), action.unsqueeze(1), times)

    @abstractmethod
    def step(self, action: Tensor) -> Contact:
        """Drive every robot for one control step with ``action`` ``[B, 2]`` = (v m/s, ω rad/s).

        A robot stops where it first touches the human, a box or the goal's disc.
        """

    @abstractmethod
    def scan(self) -> Tensor:
        """The min-pooled lidar scan from the present poses in metres, ``[B, sectors]``."""

    def state_dict(self) -> dict[str, Tensor]:
        """Everything needed to go on from here, as plain tensors."""
        return {"pose": self.pose, **self.scene.to_tensordict().to_dict()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Go on from a state that :meth:`state_dict` returned."""
        state = dict(state)
        pose = state.pop("pose").to(self.device)
        self.reset(Scene(**state, batch_size=pose.shape[:1]))
        self.pose = pose.clone()


def without_human(observation: Tensor) -> Tensor:
    """Raw observations ``[..., 4 + sectors]`` without the human's distance and bearing, ``[..., 2 + sectors]``.

    Examples:
        >>> without_human(torch.arange(6.0))
        tensor([0., 1., 4., 5.])
    """
    return torch.cat([observation[..., :2], observation[..., 4:]], -1)
