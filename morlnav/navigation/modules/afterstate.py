"""What an action leads to, as far as it follows from how the robot moves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from morlnav.navigation.modules.features import NavigationFeatures, nearness
from morlnav.navigation.world import DifferentialDrive


class AfterstateFeatures(nn.Module):
    """Features of what will be seen after one control step (Sutton & Barto, 2018, Sec. 6.8).

    A single action changes the return by less than a critic's error. Most of what it does change follows from the
    robot's own motion: a critic that is given this need not learn how bearings turn with ω, and its gradient in the
    action comes from a value in the state. Goal and human are exact if the human stands still and no contact ends the
    step. How much room there will be ahead is known as well as the lidar's sectors tell bearings.

    Args:
        robot: how it moves; the robot of Sec. III-B.1 by default.
        step_time: one control step in seconds.
        observe_human: whether the observation holds the human's distance and bearing.
        octaves: Fourier features of the distances, as of :class:`~morlnav.navigation.modules.NavigationFeatures`.
        lookahead: distances straight ahead in metres; at each, how near the closest thing is that the lidar sees.

    Attributes:
        out_features: number of features.

    Examples:
        >>> features = AfterstateFeatures()
        >>> features.predict(torch.tensor([3.0, 0.0, 1.5, 0.0]), features.motion(torch.tensor([0.5, 0.0])))
        tensor([2.9000, 0.0000, 1.4000, 0.0000])
        >>> features(torch.zeros(5, 34), torch.zeros(5, 2)).shape
        torch.Size([5, 24])
        >>> AfterstateFeatures(lookahead=[0.0, 0.5])(torch.zeros(5, 34), torch.zeros(5, 2)).shape
        torch.Size([5, 28])
    """

    def __init__(
        self,
        robot: DifferentialDrive | None = None,
        step_time: float = 0.2,
        observe_human: bool = True,
        octaves: int = 4,
        lookahead: Sequence[float] = (),
    ) -> None:
        super().__init__()
        self.robot = robot if robot is not None else DifferentialDrive()
        self.step_time = step_time
        self.features = NavigationFeatures(observe_human, sectors=0, use_lidar=False, octaves=octaves)
        self.lookahead = tuple(lookahead)
        self.out_features = self.features.out_features + 2 * len(self.lookahead)

    def motion(self, action: Tensor) -> Tensor:
        """Where the step of an action ``[..., 2]`` ends: ``(x, y, turn)`` in the robot's frame, ``[..., 3]``."""
        return self.robot.move(action.new_zeros(3), action, self.step_time)

    def predict(self, observation: Tensor, motion: Tensor) -> Tensor:
        """Distances (m) and bearings (rad) after a motion, ``[..., 4]`` of goal and human or ``[..., 2]`` of the goal.

        Bearings may leave ``[-π, π]`` by the turn of one step.
        """
        x, y, turn = motion.split(1, -1)
        distance, bearing = observation[..., : self.features.in_features].unflatten(-1, (-1, 2)).unbind(-1)
        ahead, left = distance * bearing.cos() - x, distance * bearing.sin() - y
        return torch.stack([torch.hypot(ahead, left), torch.atan2(left, ahead) - turn], -1).flatten(-2)

    def clearance(self, observation: Tensor, motion: Tensor) -> Tensor:
        """How near the closest thing that the lidar sees is to each point ahead, ``[..., len(lookahead)]`` in metres.

        Points lie straight ahead of where a motion ends. What a sector sees counts as being in the sector's middle.
        """
        scan = observation[..., self.features.in_features :].unsqueeze(-2)
        bearing = (torch.arange(0.5, scan.shape[-1], device=scan.device) * 2 / scan.shape[-1] - 1) * math.pi
        turn = motion[..., 2:]
        course = torch.cat([turn.cos(), turn.sin()], -1)
        points = torch.stack([motion[..., :2] + distance * course for distance in self.lookahead], -2)
        x, y = points.split(1, -1)
        return torch.hypot(scan * bearing.cos() - x, scan * bearing.sin() - y).amin(-1)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """Features ``[..., out_features]`` of raw observations ``[..., D]`` and actions ``[..., 2]`` (m/s, rad/s)."""
        motion = self.motion(action)
        features = self.features(self.predict(observation, motion))
        if not self.lookahead:
            return features
        clearance = self.clearance(observation, motion)
        return torch.cat([features, (-clearance).exp(), nearness(clearance)], -1)
