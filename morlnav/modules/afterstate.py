"""What an action leads to, as far as it follows from how the robot moves."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from morlnav.modules.networks import NavigationFeatures
from morlnav.world import DifferentialDrive


class AfterstateFeatures(nn.Module):
    """Features of where goal and human will be seen from after one control step (Sutton & Barto, 2018, Sec. 6.8).

    A single action changes the return by less than a critic's error. Most of what it does change follows from the
    robot's own motion: a critic that is given this need not learn how bearings turn with ω, and its gradient in the
    action comes from a value in the state. Exact for a human who stands still, unless a contact ends the step.

    Args:
        robot: how it moves; the robot of Sec. III-B.1 by default.
        step_time: one control step in seconds.
        observe_human: whether the observation holds the human's distance and bearing.
        octaves: Fourier features of the distances, as of :class:`~morlnav.modules.NavigationFeatures`.

    Attributes:
        out_features: number of features.

    Examples:
        >>> features = AfterstateFeatures()
        >>> features.predict(torch.tensor([3.0, 0.0, 1.5, 0.0]), torch.tensor([0.5, 0.0]))
        tensor([2.9000, 0.0000, 1.4000, 0.0000])
        >>> features(torch.zeros(5, 34), torch.zeros(5, 2)).shape
        torch.Size([5, 24])
    """

    def __init__(
        self,
        robot: DifferentialDrive | None = None,
        step_time: float = 0.2,
        observe_human: bool = True,
        octaves: int = 4,
    ) -> None:
        super().__init__()
        self.robot = robot if robot is not None else DifferentialDrive()
        self.step_time = step_time
        self.features = NavigationFeatures(observe_human, sectors=0, use_lidar=False, octaves=octaves)
        self.out_features = self.features.out_features

    def predict(self, observation: Tensor, action: Tensor) -> Tensor:
        """Distances (m) and bearings (rad) after the step, ``[..., 4]`` of goal and human or ``[..., 2]`` of the goal.

        Bearings may leave ``[-π, π]`` by the turn of one step.
        """
        x, y, turn = self.robot.move(action.new_zeros(3), action, self.step_time).split(1, -1)
        distance, bearing = observation[..., : self.features.in_features].unflatten(-1, (-1, 2)).unbind(-1)
        ahead, left = distance * bearing.cos() - x, distance * bearing.sin() - y
        return torch.stack([torch.hypot(ahead, left), torch.atan2(left, ahead) - turn], -1).flatten(-2)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """Features ``[..., out_features]`` of raw observations ``[..., D]`` and actions ``[..., 2]`` (m/s, rad/s)."""
        return self.features(self.predict(observation, action))
