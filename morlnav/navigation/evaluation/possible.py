"""What is possible: the exact front of distance to the human and time, and how much of it a policy reaches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from morlnav.evaluation.pareto import Scalarisation, utility
from morlnav.navigation.envs import Objective, Transition
from morlnav.navigation.envs.step import reward_vector
from morlnav.navigation.evaluation.metrics import is_free
from morlnav.navigation.evaluation.paths import evenly, polyline_lengths, shortest_polylines
from morlnav.navigation.evaluation.statistics import on_edge, tuneable_objectives
from morlnav.navigation.world import Contact, Scene, TensorWorld, World

FARTHEST = 2.0
"""Metres from the human beyond which a distance is worth nothing (``d_thresh`` of Eq. 3)."""

EDGE = ("distance", "efficiency")
"""The objectives that the front trades off."""

SLOWEST = 1.12
"""Time over the shortest path's from which on a point has no share of the front."""


@dataclass(frozen=True)
class ExactFront:
    """The fastest way to keep each distance from the human, in each scene; made by :func:`exact_front`.

    Attributes:
        distance: distances ``[D]`` that a path keeps from the human's centre in metres, from contact on, rising.
        length: of the shortest path that keeps it, in metres, ``[S, D]``; ``inf`` where there is none.
        paths: these paths, ``paths[s][d]`` of shape ``[L, 2]``; ``[0, 2]`` where there is none.
    """

    distance: Tensor
    length: Tensor
    paths: list[list[Tensor]]

    @property
    def ratio(self) -> Tensor:
        """Length over the shortest path's, ``[S, D]``."""
        return self.length / self.length[:, :1]

    @property
    def time_ratio(self) -> Tensor:
        """Mean time over the shortest path's ``[D]``, over the scenes in which every distance can be kept."""
        return self.ratio[self.length.isfinite().all(1)].mean(0)

    def table(self) -> pd.DataFrame:
        """A row per scene and distance: ``length`` in metres, and its ratio to the shortest path's."""
        scenes, steps = self.length.shape
        columns = {
            "scene": torch.arange(scenes).repeat_interleave(steps),
            "distance": self.distance.repeat(scenes),
            "length": self.length.flatten(),
            "time_ratio": self.ratio.flatten(),
        }
        return pd.DataFrame({name: value.numpy() for name, value in columns.items()})

    def at(self, distance: np.ndarray) -> np.ndarray:
        """The least mean time over the shortest path's for distances ``[P]``, ``[P]``; beyond an end, the end's."""
        return np.interp(distance, self.distance.numpy(), self.time_ratio.numpy())

    def excess(self, distance: np.ndarray, time_ratio: np.ndarray) -> np.ndarray:
        """By how much points ``[P]`` take longer than the front at their distance, ``[P]``."""
        return time_ratio - self.at(distance)

    def share(self, distance: np.ndarray, time_ratio: np.ndarray) -> float:
        """The area that points ``[P]`` dominate, over the area that the front does.

        Both are measured from contact at :data:`SLOWEST`, up to :data:`FARTHEST`. A robot that follows the front in
        eleven steps and loses 1 % of time everywhere has a share of 0.8; with 3 %, 0.57. Reports take distances of all
        episodes and times of successes, so that a collision costs nothing here; the success rate stands beside it.

        Examples:
            >>> front = ExactFront(torch.tensor([0.5, 2.0]), torch.tensor([[10.0, 10.0]]), [])
            >>> round(front.share(np.array([1.25]), np.array([1.06])), 2)
            0.25
        """
        grid = np.linspace(*self.distance[[0, -1]].tolist(), 2001)
        reached, front = self.reach(distance, time_ratio, grid), self.at(grid)
        return float((SLOWEST - np.maximum(reached, front)).clip(0).sum() / (SLOWEST - front).clip(0).sum())

    @staticmethod
    def reach(distance: np.ndarray, time_ratio: np.ndarray, at: np.ndarray) -> np.ndarray:
        """The least time ratio of points ``[P]`` that keep a distance, for distances ``at`` ``[G]``; else ``SLOWEST``.

        >>> ExactFront.reach(np.array([1.0, 0.6]), np.array([1.05, 1.01]), at=np.array([0.5, 0.8, 1.5]))
        array([1.01, 1.05, 1.12])
        """
        return np.where(distance >= at[:, None], time_ratio, SLOWEST).min(1, initial=SLOWEST)


def exact_front(scenes: Scene, world: World | None = None, steps: int = 9) -> ExactFront:
    """The exact front of the scenes ``[S]``: shortest paths around a human who is made larger and larger.

    Args:
        scenes: batched ``[S]``.
        world: radii of robot, human and goal.
        steps: how many distances, from contact to :data:`FARTHEST`.

    Raises:
        ValueError: for fewer than two steps, or scenes without one batch dimension.

    Examples:
        >>> from morlnav.navigation.evaluation import evaluation_scenes
        >>> front = exact_front(evaluation_scenes(2), steps=2)
        >>> front.distance.tolist(), front.length.shape
        ([0.48, 2.0], torch.Size([2, 2]))
    """
    if steps < 2:
        raise ValueError(f"A front needs at least 2 steps, got {steps}.")
    world = world or TensorWorld()
    radius = world.robot.radius
    distance = torch.linspace(radius + world.human_radius, FARTHEST, steps, dtype=torch.float64)
    columns = [shortest_polylines(scenes, radius, kept - radius, world.goal_radius) for kept in distance.tolist()]
    length = torch.stack([polyline_lengths(lines) for lines in columns], 1)
    return ExactFront(distance.round(decimals=6), length, [list(row) for row in zip(*columns, strict=True)])


def path_returns(
    paths: list[Tensor], scenes: Scene, objectives: Mapping[str, Objective], world: World | None = None
) -> Tensor:
    """What the environment would pay, undiscounted, for driving along polylines at full speed, ``[S, m]``.

    The robot turns on the spot and in no time, so a path at its best: what a real robot gains falls short of it.

    Args:
        paths: a polyline ``[L, 2]`` in metres for each scene.
        scenes: batched ``[S]``.
        objectives: reward terms by name.
        world: its sizes, its lidar, and the time of a step.

    Examples:
        >>> from morlnav.navigation.envs import Efficiency
        >>> from morlnav.navigation.evaluation import evaluation_scenes
        >>> line = torch.tensor([[0.0, 0.0], [1.0, 0.0]])
        >>> path_returns([line], evaluation_scenes(1), {"efficiency": Efficiency()})
        tensor([[-100.]])
    """
    given = world or TensorWorld()
    world = TensorWorld(given.robot, given.lidar, given.human_radius, given.goal_radius, given.step_time)
    drives = [_poses(path, world.robot.max_speed * world.step_time) for path in paths]
    pose, following = torch.cat([drive[:-1] for drive in drives]), torch.cat([drive[1:] for drive in drives])
    steps = torch.tensor([len(drive) - 1 for drive in drives])
    row = torch.arange(len(paths)).repeat_interleave(steps)
    world.scene, observed = scenes.cpu()[row], []
    for world.pose in (pose, following):
        observed.append(world.observe())
    arrives = torch.cat([torch.arange(count) == count - 1 for count in steps.tolist()])
    never = torch.zeros_like(arrives)
    transition = Transition(
        pose=pose,
        next_pose=following,
        action=world.robot.action_between(pose, following, world.step_time),
        observation=observed[0],
        next_observation=observed[1],
        contact=Contact(human=never, box=never, goal=arrives, batch_size=arrives.shape),
        scene=world.scene,
    )
    reward = reward_vector(objectives, transition)
    return torch.zeros(len(paths), reward.shape[1]).index_add_(0, row, reward)


def _poses(path: Tensor, reach: float) -> Tensor:
    """Where a robot that drives ``reach`` metres a step is on a polyline, facing its next step, ``[T + 1, 3]``."""
    path = path.double().cpu().numpy()
    point = np.concatenate([path[:1], evenly(path, reach)])
    x, y = np.diff(point, axis=0).T
    course = np.arctan2(y, x)
    return torch.from_numpy(np.column_stack([point, np.append(course, course[-1:])])).float()


def possible_table(
    front: ExactFront, summary: pd.DataFrame, utility: pd.Series | None = None, best: Tensor | None = None
) -> pd.DataFrame:
    """A policy beside what is possible, a row per preference.

    Args:
        front: of the scenes that were driven in.
        summary: from :func:`~morlnav.navigation.evaluation.summarise`.
        utility: what the policy's mean return is worth under each preference.
        best: what the best known paths' are, from :func:`best_utility`, ``[P]``.

    Returns:
        Columns ``lambda_<name>``, ``min_human_distance``, ``time_ratio``, ``on_edge``: whether λ weighs distance and
        efficiency alone, ``excess``: of time over the front at that distance, with ``best`` ``best_utility`` and
        ``regret``: what the policy lacks of it, and, the same in every row, ``front_share`` (:meth:`ExactFront.share`)
        and ``mean_excess`` of the preferences on that edge.
    """
    weights = [f"lambda_{name}" for name in tuneable_objectives(summary)]
    table = summary[[*weights, "min_human_distance", "time_ratio"]].assign(on_edge=on_edge(summary, EDGE))
    table["excess"] = front.excess(table["min_human_distance"].to_numpy(), table["time_ratio"].to_numpy())
    if best is not None:
        table["best_utility"] = best
        table["regret"] = table["best_utility"] - utility
    along = table[table["on_edge"]].dropna()
    share = front.share(along["min_human_distance"].to_numpy(), along["time_ratio"].to_numpy())
    return table.assign(front_share=share, mean_excess=along["excess"].mean())


def best_utility(
    front: ExactFront,
    scenes: Scene,
    preferences: Tensor,
    objectives: Mapping[str, Objective],
    *,
    world: World | None = None,
    references: Mapping[str, Sequence[Tensor]] | None = None,
    scalarisation: Scalarisation | None = None,
) -> Tensor:
    """What the best known path of each scene is worth, mean over scenes ``[P]``.

    Known are the paths of the front, and those of demonstrators where no box is in their way.

    Args:
        front: of the scenes.
        scenes: batched ``[S]``.
        preferences: λ, ``[P, n]``.
        objectives: reward terms by name.
        world: gives observations and sizes.
        references: demonstrators' paths, one ``[L, 2]`` per scene, by the name of their objective.
        scalarisation: weighs the returns.
    """
    world, scenes = world or TensorWorld(), scenes.cpu()
    candidates = [list(lines) for lines in zip(*front.paths, strict=True)]
    for lines in (references or {}).values():
        free = [is_free(line, boxes, world.robot.radius) for line, boxes in zip(lines, scenes.boxes, strict=True)]
        candidates.append([line if ok else line[:0] for line, ok in zip(lines, free, strict=True)])
    worth = torch.full((len(candidates), len(scenes), len(preferences)), -torch.inf, dtype=torch.float64)
    for row, lines in zip(worth, candidates, strict=True):
        known = [index for index, line in enumerate(lines) if len(line) > 1]
        if known:
            returns = path_returns([lines[index] for index in known], scenes[known], objectives, world).double()
            row[known] = utility(returns.unsqueeze(1), preferences.double(), scalarisation)
    return worth.amax(0).mean(0)


def describe_possible(table: pd.DataFrame) -> str:
    """One sentence on a :func:`possible_table`.

    >>> describe_possible(pd.DataFrame({"front_share": [0.466], "mean_excess": [0.033]}))
    'Between distance and efficiency: 47 % of the exact front, 3.3 % more time than it.'
    """
    first = table.iloc[0]
    share, excess = 100 * first["front_share"], 100 * first["mean_excess"]
    more = "" if np.isnan(excess) else f", {excess:.1f} % more time than it"
    return f"Between distance and efficiency: {share:.0f} % of the exact front{more}."
