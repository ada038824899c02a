"""Navigation metrics of single episodes (Sec. IV-C, and those of the social navigation field)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import shapely
import torch
from torch import Tensor

from morlnav.navigation.evaluation.paths import shortest_path
from morlnav.navigation.evaluation.rollout import Outcome, Rollouts
from morlnav.navigation.world import TensorWorld, World
from morlnav.navigation.world.geometry import distance_to_box, wrap_angle


def episode_metrics(
    rollouts: Rollouts,
    rewards: Sequence[str] = ("baseline", "distance", "efficiency"),
    *,
    world: World | None = None,
    references: Sequence[Tensor] | Mapping[str, Sequence[Tensor]] | None = None,
    shortest: Tensor | None = None,
    personal_space: float = 1.2,
    stalled_speed: float = 0.05,
) -> pd.DataFrame:
    """One row per preference and scene, in that order, with these columns:

    =============================  ================================================================================
    ``preference``, ``scene``      indices of λ and of the scene
    ``lambda_<name>``              entries of λ
    ``success``, ``collision_human``, ``collision_box``, ``timeout``  how the episode ended, ``bool``
    ``min_human_distance``         least distance between the centres of robot and human, m
    ``min_obstacle_distance``      least lidar reading (the lidar sees the human too), m
    ``navigation_time``            from the start to the goal, s
    ``path_length``                length of the driven arcs, m
    ``shortest_path``              length of the shortest collision-free path in the scene, m
    ``spl``                        success weighted by path length, shortest / max(driven, shortest)
    ``time_ratio``                 navigation time over the shortest path's time at full speed
    ``mean_jerk``                  mean absolute second difference of the commanded speed, m/s³; NaN below 3 steps
    ``stalled_time``               time with a commanded speed below ``stalled_speed``, s
    ``personal_space``             share of steps that end further than ``personal_space`` from the human's centre
    ``human_on_right``             1 where the robot passes clockwise around the human, else 0
    ``return_<name>``              undiscounted sum of the objective's rewards
    ``frechet``                    discrete Fréchet distance to the scene's reference path, m; only with references
    ``frechet_free``               the same where no box is in the reference's way, else NaN
    =============================  ================================================================================

    Args:
        rollouts: batched ``[P, S]``.
        rewards: names of all entries of the reward, static ones first.
        world: where the rollouts were made; its radii, step time and top speed are used.
        references: one path ``[L, 2]`` in metres per scene, such as the oracle's, with steps about as long as the
            robot's: the discrete distance compares vertices. Several by the name of their objective: that of ``demo``
            is ``frechet``, the others' are ``frechet_<name>`` and ``frechet_free_<name>``.
        shortest: lengths ``[S]`` of the shortest paths if they are known, so that they need not be searched again.
        personal_space: in metres.
        stalled_speed: in m/s.

    Raises:
        ValueError: if the number of names, references or lengths does not fit the rollouts.

    Examples:
        >>> from morlnav.navigation.evaluation.rollout import evaluate_policy, evaluation_scenes
        >>> straight = lambda observation, preference: torch.tensor([0.5, 0.0]).expand(len(observation), 2)
        >>> rollouts = evaluate_policy(straight, evaluation_scenes(3), torch.eye(2), max_steps=5)
        >>> episode_metrics(rollouts)["navigation_time"].tolist()
        [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    """
    world = world or TensorWorld()
    rollouts = rollouts.cpu()
    preferences, scenes = rollouts.batch_size
    num_terms, num_tuneable = rollouts.reward.shape[-1], rollouts.preference.shape[-1]
    if len(rewards) != num_terms:
        raise ValueError(f"The rewards have {num_terms} entries, but {len(rewards)} are named.")
    named = by_objective(references)
    for paths in named.values():
        if len(paths) != scenes:
            raise ValueError(f"Need one reference path for each of the {scenes} scenes, got {len(paths)}.")
    if shortest is None:
        shortest = shortest_path(rollouts.scene[0], world.robot.radius, world.human_radius, world.goal_radius)
    elif shortest.shape != (scenes,):
        raise ValueError(f"Need one shortest path for each of the {scenes} scenes, got {list(shortest.shape)}.")

    steps, outcome = rollouts.steps, rollouts.outcome
    driven = torch.arange(rollouts.action.shape[-2]) < steps.unsqueeze(-1)
    human_distance = (rollouts.pose[..., :2] - rollouts.scene.human.unsqueeze(-2)).norm(dim=-1)
    speed = rollouts.action[..., 0]
    time, length, least = rollouts.duration, path_length(rollouts.pose), shortest.cpu().expand(preferences, -1)
    columns = {
        "preference": torch.arange(preferences).unsqueeze(1).expand(-1, scenes),
        "scene": torch.arange(scenes).expand(preferences, -1),
        **{f"lambda_{name}": rollouts.preference[..., i] for i, name in enumerate(rewards[num_terms - num_tuneable :])},
        "success": outcome == Outcome.GOAL,
        "collision_human": outcome == Outcome.HUMAN,
        "collision_box": outcome == Outcome.BOX,
        "timeout": outcome == Outcome.TIMEOUT,
        "min_human_distance": human_distance.amin(-1),
        "min_obstacle_distance": rollouts.clearance.amin(-1),
        "navigation_time": time,
        "path_length": length,
        "shortest_path": least,
        "spl": torch.where(outcome == Outcome.GOAL, least / torch.maximum(least, length), 0.0),
        "time_ratio": time * world.robot.max_speed / least,
        "mean_jerk": (speed.diff(n=2).abs() * driven[..., 2:]).sum(-1) / (steps - 2).clamp_min(0) / world.step_time**2,
        "stalled_time": ((speed < stalled_speed) & driven).sum(-1) * world.step_time,
        "personal_space": ((human_distance[..., 1:] > personal_space) & driven).sum(-1) / steps,
        "human_on_right": (winding(rollouts.pose, rollouts.scene.human) < 0).float(),
        **{f"return_{name}": rollouts.reward[..., i].sum(-1) for i, name in enumerate(rewards)},
    }
    for name, lines in named.items():
        frechet = torch.stack([frechet_distance(paths, lines) for paths in rollouts.path])
        boxes = rollouts.scene[0].boxes
        free = [is_free(*pair, world.robot.radius) for pair in zip(lines, boxes, strict=True)]
        columns[frechet_column(name)] = frechet
        columns[frechet_column(name, "frechet_free")] = frechet.where(torch.tensor(free), torch.nan)
    return pd.DataFrame({name: _tidy(value) for name, value in columns.items()})


def by_objective(
    references: Sequence[Tensor] | Mapping[str, Sequence[Tensor]] | None,
) -> Mapping[str, Sequence[Tensor]]:
    """Reference paths by the name of their objective, which is ``demo`` where there is one alone."""
    return references if isinstance(references, Mapping) else {} if references is None else {"demo": references}


def frechet_column(objective: str, prefix: str = "frechet") -> str:
    """The column of Fréchet distances to the demonstration of an objective.

    >>> frechet_column("demo"), frechet_column("wide_left")
    ('frechet', 'frechet_wide_left')
    """
    return prefix if objective == "demo" else f"{prefix}_{objective}"


def is_free(path: Tensor, boxes: Tensor, radius: float) -> bool:
    """Whether a robot of this radius meets none of the boxes ``[K, 5]`` at the points of a path ``[L, 2]``."""
    return not (distance_to_box(path.cpu().unsqueeze(1), boxes) <= radius).any()


def _tidy(value: Tensor) -> np.ndarray:
    # λ like 0.30000001 and times like 17.399999 are noise of the number format.
    return (value.double().round(decimals=6) if value.is_floating_point() else value).flatten().numpy()


def path_length(pose: Tensor) -> Tensor:
    """Length in metres of the arcs between consecutive poses ``[..., T + 1, 3]``, summed to ``[...]``.

    >>> path_length(torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, torch.pi / 2]]))
    tensor(1.5708)
    """
    chord = pose[..., :2].diff(dim=-2).norm(dim=-1)
    turn = wrap_angle(pose[..., 2].diff(dim=-1))
    return (chord / torch.sinc(turn / (2 * torch.pi))).sum(-1)


def winding(pose: Tensor, point: Tensor) -> Tensor:
    """Angle in radians by which paths ``[..., T, 2+]`` turn counter-clockwise around points ``[..., 2]``, ``[...]``.

    >>> winding(torch.tensor([[-1.0, 0.0], [0.0, 1.0], [1.0, 0.0]]), torch.zeros(2))
    tensor(-3.1416)
    """
    arm = pose[..., :2] - point.unsqueeze(-2)
    return wrap_angle(torch.atan2(arm[..., 1], arm[..., 0]).diff(dim=-1)).sum(-1)


def frechet_distance(paths: Sequence[Tensor], references: Sequence[Tensor]) -> Tensor:
    """Discrete Fréchet distances in metres between paths ``[L, 2]``, pair by pair, ``[S]``.

    >>> frechet_distance([torch.tensor([[0.0, 0.0], [4.0, 0.0]])], [torch.tensor([[0.0, 1.0], [4.0, 3.0]])])
    tensor([3.], dtype=torch.float64)
    """
    lines = [np.array([shapely.linestrings(line.double().cpu().numpy()) for line in x]) for x in (paths, references)]
    return torch.from_numpy(np.atleast_1d(shapely.frechet_distance(*lines)))
