"""A scene as a grid of robot poses, with a handful of motions between them: what a planner walks on."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from morlnav.navigation.world import Scene, World
from morlnav.navigation.world.geometry import distance_to_box, polar, to_frame, wrap_angle

ROOM = 0.6
"""How far the grid reaches beyond start and goal, in metres."""


class PoseGrid:
    """Poses ``x, y, heading`` in the frame with the start at the origin and the goal on the x axis.

    There is one heading per lidar sector, so that the robot turns by whole sectors and a turn only rolls the scan. From
    each pose the robot can drive straight, at full or half speed, or along arcs of one or two sectors to either side,
    for two control steps, or turn on the spot for one. Tables over the grid are ordered
    ``[heading, primitive, x, y]``.

    Args:
        scene: without a batch dimension.
        world: sizes, kinematics and lidar.
        spacing: of the grid in metres; half of it is kept to human and boxes, so that what is free for a point of the
            grid is free for the points around it.
        margin: how far the grid reaches around the human in metres; its edge is a wall.

    Attributes:
        point: positions ``[X, Y, 2]`` in metres.
        free: where the robot touches nothing, ``bool`` ``[X, Y]``.
        known: ``free`` without the goal's disc, ``bool`` ``[X, Y]``.
        action: of the primitives, ``[A, 2]``.
        steps: control steps that a primitive takes, ``[A]``.
        next_heading: index of the heading it leads to, ``[H, A]``.
        ways: how far it leads in one and in two control steps, ``[H, A, 2, 2]``.
        sector: between neighbouring headings, in radians.

    Raises:
        ValueError: for a batch of scenes, or a lidar with fewer than 10 sectors.

    Examples:
        >>> from morlnav.navigation.evaluation import evaluation_scenes
        >>> from morlnav.navigation.world import TensorWorld
        >>> grid = PoseGrid(evaluation_scenes(1)[0], TensorWorld())
        >>> grid.observation(heading=0).shape[0] == grid.free.sum()
        tensor(True)
    """

    def __init__(self, scene: Scene, world: World, spacing: float = 0.1, margin: float = 2.2) -> None:
        if scene.batch_size:
            raise ValueError(f"Planning takes one scene at a time, got a batch of {list(scene.batch_size)}.")
        if world.lidar.sectors < 10:
            raise ValueError(f"Planning needs a lidar of at least 10 sectors, got {world.lidar.sectors}.")
        self.scene, self.world, self.spacing = scene, world, spacing
        axis = scene.goal - scene.start[:2]
        self.turned = torch.atan2(axis[1], axis[0])
        self.goal, self.human = (to_frame(point, scene.start[:2], self.turned) for point in (scene.goal, scene.human))
        centre = to_frame(scene.boxes[:, :2], scene.start[:2], self.turned)
        self.boxes = torch.cat([centre, scene.boxes[:, 2:4], scene.boxes[:, 4:] - self.turned], -1)

        low = torch.minimum(self.human - margin, torch.full((2,), -ROOM))
        high = torch.maximum(self.human + margin, self.goal + ROOM)
        self.low = (low / spacing).floor() * spacing
        self.counts = ((high - self.low) / spacing).ceil().long() + 1
        self.high = self.low + (self.counts - 1) * spacing
        lines = [low + spacing * torch.arange(int(n)) for low, n in zip(self.low, self.counts, strict=True)]
        self.point = torch.stack(torch.meshgrid(*lines, indexing="ij"), -1)
        self.room = spacing / 2
        self.free = ~self.touches(self.point, self.room)
        self.known = self.free & ~self.at_goal(self.point)
        self.goal_distance = (self.point - self.goal).norm(dim=-1)
        self._make_primitives()
        self._look()

    def _make_primitives(self) -> None:
        """What the robot can do from each heading, and where that leads."""
        world, headings = self.world, self.world.lidar.sectors
        self.sector, step, speed = 2 * math.pi / headings, world.step_time, world.robot.max_speed
        spin = int(world.robot.max_turn * step / self.sector + 1e-4)
        turns = torch.tensor([0, 0, 1, -1, 2, -2, spin, -spin])
        self.steps = torch.tensor([2, 2, 2, 2, 2, 2, 1, 1])
        rate = turns * self.sector / (self.steps * step)
        self.action = torch.stack([speed * torch.tensor([1, 0.5, 1, 1, 1, 1, 0, 0]), rate], -1)
        heading = torch.arange(headings)
        self.next_heading = (heading.unsqueeze(1) + turns) % headings
        times = torch.minimum(torch.arange(1, 3), self.steps.unsqueeze(1)) * step
        pose = F.pad((heading * self.sector).unsqueeze(1), (2, 0)).reshape(-1, 1, 1, 3)
        ways = world.robot.move(pose, self.action.unsqueeze(1), times)
        self.ways = ways[..., :2]

    def observation(self, heading: int) -> Tensor:
        """Raw observations ``[N, 34]`` from the ``N`` free points, looking along the heading of this index."""
        turned = torch.tensor([0.0, heading * self.sector])
        goal, human = (place - turned for place in self._places)
        goal, human = (torch.stack([place[:, 0], wrap_angle(place[:, 1])], -1) for place in (goal, human))
        return torch.cat([goal, human, self._scan.roll(-heading, 1)], -1)

    def _look(self) -> None:
        """Look around from every free point once, along the first heading."""
        pose = F.pad(self.point[self.free], (0, 1))
        self._places = polar(self.goal, pose), polar(self.human, pose)
        human, boxes = self.human.expand(len(pose), -1), self.boxes.expand(len(pose), -1, -1)
        parts = zip(pose.split(2048), human.split(2048), boxes.split(2048), strict=True)
        self._scan = torch.cat([self.world.lidar.scan(*part, self.world.human_radius) for part in parts])

    def to_world(self, pose: Tensor) -> Tensor:
        """Points ``[..., 2]`` or poses ``[..., 3]`` in the world frame."""
        position = self.scene.start[:2] + to_frame(pose[..., :2], pose.new_zeros(2), -self.turned)
        return torch.cat([position, wrap_angle(pose[..., 2:] + self.turned)], -1)

    def touches(self, point: Tensor, room: float = 0.0) -> Tensor:
        """Whether the robot, and some ``room`` around it, meets the human or a box at ``point``, or leaves the grid."""
        robot = self.world.robot.radius + room
        contact = ((point < self.low - 1e-4) | (point > self.high + 1e-4)).any(-1)
        contact |= (point - self.human).norm(dim=-1) <= self.world.human_radius + robot
        for box in self.boxes:
            contact |= distance_to_box(point, box) <= robot
        return contact

    def at_goal(self, point: Tensor) -> Tensor:
        """Whether ``point`` ``[..., 2]`` lies within the goal's disc."""
        return (point - self.goal).norm(dim=-1) <= self.world.goal_radius

    def share(self, point: Tensor, ways: Tensor) -> Tensor:
        """How much of the way from ``point`` ``[..., 2]`` along ``ways`` ``[2, ..., 2]`` it takes to the goal, else ∞.

        Charging that share alone keeps the value free of stairs around the goal, which interpolation would blur.
        """
        before, after = (point - self.goal).norm(dim=-1), (ways[1] - self.goal).norm(dim=-1)
        share = (before - self.world.goal_radius) / (before - after).clamp_min(1e-6)
        return share.clamp(0, 1).where(self.at_goal(ways).any(0), torch.inf)

    def ends(self, ways: Tensor) -> tuple[Tensor, Tensor]:
        """:meth:`share` of the ``ways`` ``[A, 2, 2]`` from all points, and whether they touch, ``[A, X, Y]`` each."""
        point = self.point + ways[:, :, None, None]
        contact = self.touches(point, self.room).any(1)
        return self.share(self.point, point.movedim(1, 0)).masked_fill(contact, torch.inf), contact

    def shift_kernel(self) -> Tensor:
        """Convolution kernels that look values up where the primitives end, ``[heading·primitive, 1, K, K]``."""
        shift = self.ways[:, :, -1].reshape(-1, 2) / self.spacing
        corner = shift.floor()
        share = shift - corner
        reach = int(shift.abs().max().ceil()) + 1
        kernel = torch.zeros(len(shift), 2 * reach + 1, 2 * reach + 1)
        row = torch.arange(len(shift))
        for dx, dy in ((0, 0), (0, 1), (1, 0), (1, 1)):
            i, j = (corner.long() + reach + torch.tensor([dx, dy])).T
            weight = torch.where(torch.tensor([dx, dy]) == 1, share, 1 - share).prod(-1)
            kernel[row, i, j] += weight
        return kernel.unsqueeze(1)

    def nearest(self, point: Tensor) -> Tensor:
        """Indices of the grid points nearest to ``point`` ``[..., 2]``."""
        index = ((point - self.low) / self.spacing).round().long().clamp_min(0)
        return torch.minimum(index, self.counts - 1)

    def interpolate(self, table: Tensor, point: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
        """Values of ``[P, x, y]`` at points ``[P, 2]``, linear between ``known`` grid points, and their weight."""
        place = (point - self.low) / self.spacing
        corner = torch.minimum(place.floor().long().clamp_min(0), self.counts - 2)
        share = (place - corner).clamp(0, 1)
        row, total, support = torch.arange(len(point)), 0.0, 1e-6
        for offset in torch.tensor([[0, 0], [0, 1], [1, 0], [1, 1]]):
            i, j = (corner + offset).T
            weight = torch.where(offset == 1, share, 1 - share).prod(-1) * known[i, j]
            total, support = total + weight * table[row, i, j], support + weight
        return total / support, support
