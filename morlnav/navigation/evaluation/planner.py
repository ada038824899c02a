"""What a demonstration reward really asks for: the best path under it, by value iteration over a grid of poses."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.nn import functional as F

from morlnav.navigation.evaluation.metrics import winding
from morlnav.navigation.evaluation.pose_grid import PoseGrid
from morlnav.navigation.evaluation.rollout import Outcome
from morlnav.navigation.world import Scene, TensorWorld, World, without_human


@dataclass(frozen=True)
class PlannedPath:
    """The optimum of a reward in one scene.

    Attributes:
        scene: without a batch dimension.
        pose: x, y (m) and heading (rad), one per control step, ``[L, 3]``.
        outcome: how the path ends.
        reward_map: ``R̂`` of the best motion in the best heading at every point of the grid, ``[X, Y]``; NaN where the
            robot would touch something.
        grid: the points, in metres in the world frame, ``[X, Y, 2]``.
    """

    scene: Scene
    pose: Tensor
    outcome: Outcome
    reward_map: Tensor
    grid: Tensor

    @property
    def path(self) -> Tensor:
        """Positions in metres, ``[L, 2]``."""
        return self.pose[:, :2]

    @property
    def min_human_distance(self) -> float:
        """Least distance between the centres of robot and human, in metres."""
        return (self.path - self.scene.human).norm(dim=-1).min().item()

    @property
    def human_on_right(self) -> bool:
        """Whether the robot passes clockwise around the human."""
        return winding(self.path, self.scene.human).item() < 0


@dataclass(frozen=True)
class PathPlanner:
    """Finds the path that maximises baseline plus ``scale·(R̂(s, a) + offset)`` per step, boxes and human included.

    Value iteration over a :class:`~morlnav.navigation.evaluation.pose_grid.PoseGrid`; between its points values are
    interpolated, linearly and only among those that are free. The horizon is finite and γ = 1, as in an episode with a
    time limit: a reward that pays for dawdling gets a path that dawdles. The path found is that of the greedy policy.

    Args:
        scale: the factor ``c_d``.
        offset: ``b_d``, added to ``R̂``.
        world: sizes, kinematics and lidar; a default :class:`~morlnav.navigation.world.TensorWorld` by default.
        observe_human: whether the reward sees the human's position (``-NH`` ablation).
        spacing: of the grid in metres.
        margin: how far the grid reaches around the human in metres; its edge is a wall.
        max_steps: control steps of the horizon.
        progress: reward per metre of progress toward the goal (Sec. III-D.1).
        collision: reward for touching something.
        step_cost: a little for every step, which decides between paths that are equally good otherwise.

    Raises:
        ValueError: at the call, if the lidar has fewer than 10 sectors.

    Examples:
        >>> from morlnav.navigation.evaluation import evaluation_scenes
        >>> planner = PathPlanner(spacing=0.2)
        >>> planned = planner(lambda observation, action: torch.full_like(action[:, 0], 0.9), evaluation_scenes(1)[0])
        >>> planned.outcome.name
        'GOAL'
    """

    scale: float = 10.0
    offset: float = -1.0
    world: World = field(default_factory=TensorWorld, repr=False)
    observe_human: bool = True
    spacing: float = 0.1
    margin: float = 2.2
    max_steps: int = 250
    progress: float = 125.0
    collision: float = -1000.0
    step_cost: float = 0.05

    @torch.no_grad()
    def __call__(self, reward: Callable[[Tensor, Tensor], Tensor], scene: Scene) -> PlannedPath:
        """Plan in one ``scene`` without a batch dimension; ``reward`` maps ``[B, 34]`` and ``[B, 2]`` to ``[B]``.

        Raises:
            ValueError: for a batch of scenes.
        """
        grid = PoseGrid(scene.cpu(), self.world, self.spacing, self.margin)
        table = self._reward_table(reward, grid)
        pose, outcome = self._roll_out(table, self._value(table, grid), grid)
        best = (table / grid.steps[:, None, None] + self.step_cost).amax((0, 1)) / self.scale - self.offset
        return PlannedPath(
            scene=grid.scene,
            pose=grid.to_world(pose),
            outcome=outcome,
            reward_map=best.where(grid.free, torch.nan),
            grid=grid.to_world(grid.point),
        )

    def _reward_table(self, reward: Callable[[Tensor, Tensor], Tensor], grid: PoseGrid) -> Tensor:
        """What every primitive earns from every pose, ``[H, A, X, Y]``, progress and collisions aside."""
        table = torch.zeros(*grid.next_heading.shape, *grid.free.shape)
        for heading, row in enumerate(table):
            observation = grid.observation(heading)
            if not self.observe_human:
                observation = without_human(observation)
            for action, out in zip(grid.action, row, strict=True):
                out[grid.free] = reward(observation, action.expand(len(observation), 2))
        return (self.scale * (table + self.offset) - self.step_cost) * grid.steps[:, None, None]

    def _value(self, table: Tensor, grid: PoseGrid) -> Tensor:
        """The optimal return from every pose, less the constant ``progress·goal_distance`` (potential shaping)."""
        kernel = grid.shift_kernel()
        count, reach = len(kernel), kernel.shape[-1] // 2
        known = grid.known.to(table.dtype)
        weight = F.conv2d(known.expand(1, count, -1, -1), kernel, padding=reach, groups=count).view_as(table)
        share, contact = (torch.stack(flags) for flags in zip(*map(grid.ends, grid.ways), strict=True))
        arrives = share < torch.inf
        contact |= (weight < 1e-3) & ~arrives
        end = -self.progress * grid.goal_distance  # where a collision or the time limit ends the episode
        goes_on = ~(contact | arrives)
        final = torch.where(
            contact, table + self.collision + end, table * share - self.progress * self.world.goal_radius
        )
        value = end.expand(len(table), -1, -1)
        for _ in range(math.ceil(self.max_steps / 2)):
            ahead = (value * known)[grid.next_heading].view(1, count, *known.shape)
            ahead = F.conv2d(ahead, kernel, padding=reach, groups=count).view_as(table) / weight.clamp_min(1e-3)
            new = torch.where(goes_on, table + ahead, final).amax(1)
            change = (new - value)[:, grid.known].abs().max()
            value = new
            if change < 1e-3:
                break
        return value

    def _roll_out(self, table: Tensor, value: Tensor, grid: PoseGrid) -> tuple[Tensor, Outcome]:
        """Follow the best primitive from the start: poses ``[L, 3]`` in the grid's frame, and how the way ends."""
        position, heading = torch.zeros(2), round(float(grid.scene.start[2] - grid.turned) / grid.sector) % len(table)
        visits = torch.zeros_like(value)  # coming back costs: no error of interpolation may trap the robot
        poses = [torch.tensor([0.0, 0.0, heading * grid.sector])]
        while len(poses) <= self.max_steps:
            then, ways = grid.next_heading[heading], position + grid.ways[heading]
            cell = (then, *grid.nearest(ways[:, 1]).T)
            best = int((self._returns(table, value, grid, position, heading) - self.scale * visits[cell]).argmax())
            visits[tuple(index[best] for index in cell)] += 1
            for position in ways[best, : grid.steps[best]]:
                poses.append(torch.cat([position, then[best : best + 1] * grid.sector]))
                if grid.at_goal(position):
                    return torch.stack(poses), Outcome.GOAL
                if grid.touches(position):
                    near = (position - grid.human).norm() <= self.world.human_radius + self.world.robot.radius
                    return torch.stack(poses), Outcome.HUMAN if near else Outcome.BOX
            heading = int(then[best])
        return torch.stack(poses), Outcome.TIMEOUT

    def _returns(self, table: Tensor, value: Tensor, grid: PoseGrid, position: Tensor, heading: int) -> Tensor:
        """What each primitive leads to from any ``position`` ``[2]``, ``[A]``."""
        ways = position + grid.ways[heading]
        future, support = grid.interpolate(value[grid.next_heading[heading]], ways[:, 1], grid.known)
        now, _ = grid.interpolate(table[heading], position.expand(len(ways), 2), grid.free)
        share = grid.share(position, ways.transpose(0, 1))
        arrives = share < torch.inf
        blocked = grid.touches(ways).any(1) | ((support < 1e-3) & ~arrives)
        at_goal = now * share - self.progress * self.world.goal_radius
        return torch.where(arrives, at_goal, now + future) + self.collision * blocked
