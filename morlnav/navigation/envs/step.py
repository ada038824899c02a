"""One control step, for the environment and for an evaluation alike."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from morlnav.navigation.envs.checks import check_action, reward_vector
from morlnav.navigation.envs.rewards import Objective, Transition
from morlnav.navigation.world import World


def advance(
    world: World, action: Tensor, observation: Tensor, objectives: Mapping[str, Objective]
) -> tuple[Transition, Tensor]:
    """Drive every robot of a world for one control step, and pay for it.

    Args:
        world: moves on.
        action: ``(v, ω)`` in m/s and rad/s ``[B, 2]``; the motors limit it.
        observation: whole, before the step, ``[B, 34]``.
        objectives: reward terms by name.

    Returns:
        What happened, and the reward vectors ``[B, m]``.

    Raises:
        ValueError: for an action or a reward that is not finite, or one of another shape.
    """
    check_action(action)  # before it moves anything
    action, before = world.robot.limit(action), world.pose
    contact = world.step(action)
    transition = Transition(
        pose=before,
        next_pose=world.pose,
        action=action,
        observation=observation,
        next_observation=world.observe(),
        contact=contact,
        scene=world.scene,
        clearance=world.clearance(),
    )
    return transition, reward_vector(objectives, transition)
