"""Roll a policy out under every preference in every scene, all in one batch."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from enum import IntEnum

import torch
from tensordict import tensorclass
from torch import Tensor

from morlnav.evaluation.evaluator import HELD_OUT
from morlnav.limits import check_at_least
from morlnav.modules.mode import eval_mode
from morlnav.navigation.envs import Objective, default_objectives
from morlnav.navigation.envs.step import advance
from morlnav.navigation.world import Scene, SceneSampler, TensorWorld, World, without_human


class Outcome(IntEnum):
    """How an episode ended.

    >>> Outcome(1).name
    'GOAL'
    """

    TIMEOUT = 0
    GOAL = 1
    HUMAN = 2
    BOX = 3


@tensorclass
class Rollouts:
    """Episodes of ``P`` preferences in ``S`` scenes, batched ``[P, S]`` and padded to the longest one, ``T`` steps.

    Attributes:
        pose: x, y (m) and heading (rad), from the start on, ``[P, S, T + 1, 3]``; padded with the last pose.
        clearance: least lidar reading in metres at each pose, ``[P, S, T + 1]``; padded with the last one.
        action: ``(v, ω)`` in m/s and rad/s, ``[P, S, T, 2]``; padded with 0.
        reward: one entry per objective, unscaled, ``[P, S, T, m]``; padded with 0.
        steps: control steps of the episode, ``[P, S]``.
        duration: seconds until the goal, the contact or the time limit, to the world's check interval, ``[P, S]``.
        outcome: an :class:`Outcome`, ``[P, S]``.
        preference: λ, ``[P, S, n]``; of a schedule the first.
        scene: the scenes, batched ``[P, S]``.
    """

    pose: Tensor
    clearance: Tensor
    action: Tensor
    reward: Tensor
    steps: Tensor
    duration: Tensor
    outcome: Tensor
    preference: Tensor
    scene: Scene

    @property
    def path(self) -> list[list[Tensor]]:
        """Positions of every episode without the padding, ``path[p][s]`` of shape ``[steps + 1, 2]``."""
        return [
            [pose[: n + 1, :2] for pose, n in zip(poses, steps, strict=True)]
            for poses, steps in zip(self.pose, self.steps.tolist(), strict=True)
        ]


def evaluation_scenes(num: int, seed: int = 0, sampler: SceneSampler | None = None) -> Scene:
    """Draw held-out scenes from a generator of their own; the global random state is left alone.

    The generator's seed is ``2**31 + seed``, so no training seed below ``2**31`` leads to these scenes.

    Args:
        num: number of scenes ``S``.
        seed: in ``[0, 2**31)``; the same seed gives the same scenes.
        sampler: draws the scenes; those of Sec. IV-A by default.

    Raises:
        ValueError: if ``num`` is below 1 or ``seed`` is out of range.

    Examples:
        >>> evaluation_scenes(100).batch_size
        torch.Size([100])
    """
    if num < 1:
        raise ValueError(f"An evaluation needs at least one scene, got {num}.")
    if not 0 <= seed < HELD_OUT:
        raise ValueError(f"The seed of evaluation scenes must be in [0, 2**31), got {seed}.")
    return (sampler or SceneSampler())(num, generator=torch.Generator().manual_seed(HELD_OUT + seed))


@torch.no_grad()
def evaluate_policy(
    policy: Callable[[Tensor, Tensor], Tensor],
    scenes: Scene,
    preferences: Tensor,
    *,
    world: World | None = None,
    objectives: Mapping[str, Objective] | None = None,
    observe_human: bool = True,
    max_steps: int = 250,
    drop_finished: bool = True,
) -> Rollouts:
    """Drive every preference in every scene, ``P * S`` episodes side by side (Sec. IV-B, IV-C).

    Finished episodes leave the batch, so that time goes to those still running. Gradients are off and the global
    random state is restored afterwards; a module drives in evaluation mode and then goes back to its own.

    Args:
        policy: maps observations ``[B, 34]`` and preferences ``[B, n]`` to actions ``[B, 2]``.
        scenes: batched ``[S]``.
        preferences: λ, ``[P, n]``, or schedules ``[P, T, n]`` with one λ per control step, of which the last stays.
        world: the engine; a copy of it is used, so an environment's own world may be passed. Tensors by default.
        objectives: reward terms by name as for :class:`~morlnav.navigation.envs.NavigationEnv`.
        observe_human: whether observations hold the human's position (``-NH`` ablation; ``[B, 32]`` without).
        max_steps: episodes longer than this time out.
        drop_finished: set to ``False`` for a world whose ``state_dict`` cannot restore it, as with moving bodies of
            your own in a ``PymunkWorld``; finished episodes then go on unseen.

    Returns:
        Rollouts batched ``[P, S]``, on the world's device.

    Raises:
        ValueError: if scenes or preferences have the wrong shape, or ``max_steps`` is below 1; for an action or a
            reward that is not finite.

    Examples:
        >>> straight = lambda observation, preference: torch.tensor([0.5, 0.0]).expand(len(observation), 2)
        >>> rollouts = evaluate_policy(straight, evaluation_scenes(3), torch.eye(2), max_steps=5)
        >>> rollouts.batch_size, rollouts.reward.shape
        (torch.Size([2, 3]), torch.Size([2, 3, 5, 3]))
    """
    world = copy.copy(world) if world is not None else TensorWorld()  # a reset replaces the state, it never edits it
    objectives = default_objectives() if objectives is None else objectives
    tuneable = sum(not getattr(term, "static", False) for term in objectives.values())
    if preferences.dim() not in (2, 3) or preferences.shape[-1] != tuneable or not preferences.numel():
        raise ValueError(
            f"Preferences need the shape [P, {tuneable}], one column per tuneable objective, or [P, T, {tuneable}] as "
            f"schedules; got {list(preferences.shape)}."
        )
    if len(scenes.batch_size) != 1:
        raise ValueError(f"Scenes need one batch dimension [S], got {list(scenes.batch_size)}.")
    check_at_least(1, max_steps=max_steps)

    batch = (len(preferences), len(scenes))
    grid = scenes.to(world.device).expand(*batch)
    schedule = preferences.to(world.device, torch.float32).reshape(len(preferences), -1, tuneable)
    schedule = schedule.repeat_interleave(len(scenes), 0)
    world.reset(grid.reshape(-1))

    count = len(schedule)
    pose = world.pose.new_zeros(count, max_steps + 1, 3)
    clearance = pose.new_zeros(count, max_steps + 1)
    action_log, reward = pose.new_zeros(count, max_steps, 2), pose.new_zeros(count, max_steps, len(objectives))
    steps = torch.full((count,), max_steps, device=world.device)
    outcome = torch.full_like(steps, Outcome.TIMEOUT)
    duration = pose.new_zeros(count)

    episode = torch.arange(count, device=world.device)  # which episode each slot of the world drives
    running = torch.ones_like(episode, dtype=torch.bool)
    lidar = -world.lidar.sectors
    with torch.random.fork_rng(devices=[world.device] if world.device.type == "cuda" else []), eval_mode(policy):
        observation = world.observe()
        pose[:, 0], clearance[:, 0] = world.pose, observation[:, lidar:].amin(-1)
        for step in range(max_steps):
            visible = observation if observe_human else without_human(observation)
            preference = schedule[episode, min(step, schedule.shape[1] - 1)]
            transition, paid = advance(world, policy(visible, preference), observation, objectives)
            contact, next_observation = transition.contact, transition.next_observation
            done = contact.goal | contact.human | contact.box
            ended = torch.where(contact.goal, Outcome.GOAL, torch.where(contact.human, Outcome.HUMAN, Outcome.BOX))
            now, last = episode[running], episode[running & done]
            pose[now, step + 1] = world.pose[running]
            clearance[now, step + 1] = next_observation[running, lidar:].amin(-1)
            action_log[now, step] = transition.action[running]
            reward[now, step] = paid[running]
            steps[last], outcome[last] = step + 1, ended[running & done]
            duration[now] += world.step_time if contact.duration is None else contact.duration[running]

            observation, running = next_observation, running & ~done
            if not running.any():
                break
            if drop_finished and not running.all():
                world.load_state_dict({name: value[running] for name, value in world.state_dict().items()})
                episode, observation, running = episode[running], observation[running], running[running]

    longest = int(steps.max())
    kept = torch.arange(longest + 1, device=world.device).expand(count, -1).clamp_max(steps.unsqueeze(1))
    return Rollouts(
        pose=pose.gather(1, kept.unsqueeze(-1).expand(-1, -1, 3)).unflatten(0, batch),
        clearance=clearance.gather(1, kept).unflatten(0, batch),
        action=action_log[:, :longest].unflatten(0, batch),
        reward=reward[:, :longest].unflatten(0, batch),
        steps=steps.unflatten(0, batch),
        duration=duration.unflatten(0, batch),
        outcome=outcome.unflatten(0, batch),
        preference=schedule[:, 0].unflatten(0, batch),
        scene=grid,
        batch_size=batch,
    )
