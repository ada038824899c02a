"""Paths that Fréchet distances are measured to."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from morlnav.navigation.evaluation.rollout import Outcome, evaluate_policy
from morlnav.navigation.world import Scene, World


def reference_paths(
    scenes: Scene, policy: Callable[[Tensor], Tensor], *, world: World | None = None, max_steps: int = 250
) -> list[Tensor]:
    """The path that a demonstrating policy would take in each scene if there were no boxes (Sec. IV-C, Fig. 3).

    Args:
        scenes: batched ``[S]``; their boxes are left out.
        policy: maps raw observations ``[B, 34]`` to actions ``[B, 2]``, such as the oracle.
        world: the engine; a copy of it is used. Tensors by default.
        max_steps: limit on the path's steps.

    Returns:
        One path ``[L, 2]`` in metres per scene, one point per control step, from the start to the goal's disc.

    Raises:
        ValueError: if the policy does not reach a goal, or scenes have the wrong shape.

    Examples:
        >>> from morlnav.navigation.evaluation.metrics import frechet_distance
        >>> from morlnav.navigation.evaluation.rollout import evaluation_scenes
        >>> from morlnav.navigation.modules import CircumnavigationOracle
        >>> clockwise, counter = CircumnavigationOracle(), CircumnavigationOracle(clockwise=False)
        >>> scenes = evaluation_scenes(2)
        >>> frechet_distance(reference_paths(scenes, clockwise), reference_paths(scenes, counter)).round(decimals=1)
        tensor([2., 2.], dtype=torch.float64)
    """
    rollouts = evaluate_policy(
        lambda observation, _: policy(observation),
        without_boxes(scenes),
        torch.zeros(1, 2),
        world=world,
        max_steps=max_steps,
    )
    missed = (rollouts.outcome[0] != Outcome.GOAL).sum().item()
    if missed:
        raise ValueError(
            f"The reference policy misses the goal in {missed} of {len(scenes)} scenes without boxes; "
            f"its paths are no reference there."
        )
    return rollouts.path[0]


def without_boxes(scenes: Scene) -> Scene:
    """The same scenes, with only the human in them; any batch size.

    >>> from morlnav.navigation.evaluation.rollout import evaluation_scenes
    >>> without_boxes(evaluation_scenes(2)).boxes.shape[:2]
    torch.Size([2, 0])
    """
    return Scene(
        start=scenes.start,
        goal=scenes.goal,
        human=scenes.human,
        boxes=scenes.boxes[..., :0, :],
        batch_size=scenes.batch_size,
    )
