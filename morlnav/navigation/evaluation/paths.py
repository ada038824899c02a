"""The shortest collision-free path of every scene, the yardstick for path lengths and times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from morlnav.navigation.world import Scene

TOUCH = 1e-6
"""Paths may graze obstacles; a path is blocked only if it enters one by more than this, in metres."""


def shortest_path(
    scene: Scene, robot_radius: float = 0.18, human_radius: float = 0.3, goal_radius: float = 0.35, quad_segs: int = 16
) -> Tensor:
    """Length in metres of the shortest path of the robot's centre from the start to the goal's disc, ``[S]``.

    ``inf`` where there is no path. Arguments, accuracy and errors as for :func:`shortest_polylines`.

    Examples:
        >>> import math
        >>> scene = Scene(
        ...     start=torch.zeros(1, 3),
        ...     goal=torch.tensor([[8.0, 0.0]]),
        ...     human=torch.tensor([[4.0, 5.0]]),
        ...     boxes=torch.zeros(1, 0, 5),
        ...     batch_size=[1],
        ... )
        >>> shortest_path(scene)
        tensor([7.6500], dtype=torch.float64)
    """
    return polyline_lengths(shortest_polylines(scene, robot_radius, human_radius, goal_radius, quad_segs))


def polyline_lengths(lines: Sequence[Tensor]) -> Tensor:
    """Lengths of polylines ``[L, 2]`` in metres, ``[S]``; ``inf`` of an empty one.

    >>> polyline_lengths([torch.tensor([[0.0, 0.0], [3.0, 4.0]]), torch.zeros(0, 2)])
    tensor([5., inf], dtype=torch.float64)
    """
    lengths = [line.diff(dim=0).norm(dim=-1).sum() if len(line) else torch.tensor(torch.inf) for line in lines]
    return torch.tensor(lengths, dtype=torch.float64)


def evenly(path: np.ndarray, spacing: float) -> np.ndarray:
    """Points ``[L, 2]`` on a polyline, ``spacing`` metres of arc apart, without its first and with its last point."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.append(np.arange(spacing, along[-1], spacing), along[-1])
    return np.stack([np.interp(at, along, coordinate) for coordinate in path.T], 1)


def shortest_polylines(
    scene: Scene, robot_radius: float = 0.18, human_radius: float = 0.3, goal_radius: float = 0.35, quad_segs: int = 16
) -> list[Tensor]:
    """The shortest paths themselves, by Dijkstra on the visibility graph of the inflated human and boxes.

    The robot is a point among obstacles that are inflated by its radius, and may turn on the spot. Round corners are
    polygons with ``quad_segs`` edges per quarter, which shortens an arc by 0.04 % at 16. From the last obstacle the
    path heads for the goal's centre, which is exact as long as no inflated obstacle reaches into the goal's disc;
    otherwise the path may be longer than the shortest by a fraction of ``goal_radius``.

    Args:
        scene: batched ``[S]``.
        robot_radius: in metres.
        human_radius: in metres.
        goal_radius: the path ends within this distance of the goal, in metres.
        quad_segs: edges per quarter of a circle.

    Returns:
        One polyline ``[L, 2]`` (float64) per scene; ``[0, 2]`` where there is no path.

    Raises:
        ValueError: if the scene does not have one batch dimension.

    Examples:
        >>> from morlnav.navigation.evaluation.rollout import evaluation_scenes
        >>> route = shortest_polylines(evaluation_scenes(1))[0]
        >>> route[0].tolist()  # the start, beside a human in the way
        [0.0, 0.0]
    """
    if len(scene.batch_size) != 1:
        raise ValueError(f"Shortest paths need scenes with one batch dimension [S], got {list(scene.batch_size)}.")
    scene = scene.cpu()
    start, goal = scene.start[:, :2].double().numpy(), scene.goal.double().numpy()
    obstacles = _inflated(scene, robot_radius, human_radius, quad_segs)
    return [torch.from_numpy(_route(*rest, goal_radius)) for rest in zip(start, goal, obstacles, strict=True)]


def _inflated(scene: Scene, robot_radius: float, human_radius: float, quad_segs: int) -> np.ndarray:
    """The regions that the robot's centre must not enter, one geometry per scene."""
    human = shapely.buffer(shapely.points(scene.human.double().numpy()), human_radius + robot_radius, quad_segs)
    x, y, length, width, angle = np.moveaxis(scene.boxes.double().numpy(), -1, 0)[..., None]
    along, across = length * np.array([1, 1, -1, -1]), width * np.array([-1, 1, 1, -1])
    corners = np.stack(
        [x + along * np.cos(angle) - across * np.sin(angle), y + along * np.sin(angle) + across * np.cos(angle)], -1
    )
    boxes = shapely.buffer(shapely.polygons(corners), robot_radius, quad_segs)
    return shapely.union_all(np.concatenate([human[:, None], boxes], 1), axis=1)


def _route(start: np.ndarray, goal: np.ndarray, obstacle: shapely.Geometry, goal_radius: float) -> np.ndarray:
    """The shortest polyline in one scene: node 0 is the start, then come the obstacles' corners, last the goal."""
    rings = [shapely.get_coordinates(ring)[:-1] for ring in shapely.get_rings(shapely.get_parts(obstacle))]
    corner = np.concatenate([start[None], *rings])
    before = np.concatenate([start[None], *(np.roll(ring, 1, 0) for ring in rings)]) - corner
    after = np.concatenate([start[None], *(np.roll(ring, -1, 0) for ring in rings)]) - corner
    # A shortest path only touches: where it leaves a corner, both neighbours lie on one side of it.
    line = corner[None] - corner[:, None]
    touches = _cross(line, before[:, None]) * _cross(line, after[:, None]) >= -1e-12
    tail, head = np.nonzero(np.triu(touches & touches.T, 1))
    # The goal is a disc: from each corner, head for its centre until within reach.
    offset = goal - corner
    distance = np.linalg.norm(offset, axis=1)
    aim = corner + offset * np.clip(1 - goal_radius / np.maximum(distance, 1e-12), 0, None)[:, None]

    ends = np.concatenate([np.stack([corner[tail], corner[head]], 1), np.stack([corner, aim], 1)])
    inside = shapely.buffer(obstacle, -TOUCH, join_style="mitre")
    shapely.prepare(inside)
    free = ~shapely.intersects(inside, shapely.linestrings(ends))
    last = len(corner)
    tail, head = np.append(tail, np.arange(last))[free], np.append(head, np.full(last, last))[free]
    length = np.maximum(np.linalg.norm(ends[free, 1] - ends[free, 0], axis=1), 1e-12)  # 0 would mean: no edge
    graph = coo_array((length, (tail, head)), shape=(last + 1, last + 1)).tocsr()
    _, previous = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
    if previous[last] < 0:
        return np.zeros((0, 2))
    nodes = [previous[last]]
    while nodes[-1] != 0:
        nodes.append(previous[nodes[-1]])
    return np.concatenate([corner[nodes[::-1]], aim[nodes[:1]]])


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
