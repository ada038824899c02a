"""Recording demonstrations: successful episodes of a policy in random scenes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from tensordict import TensorDict
from torch import Tensor

from morlnav.limits import check_at_least
from morlnav.modules.mode import eval_mode
from morlnav.navigation.envs import NavigationEnv, Objective, Transition
from morlnav.navigation.envs.checks import reward_vector
from morlnav.navigation.world import Contact, Scene, TensorWorld, World, without_human

PATIENCE = 20
"""Recording gives up after this many tries per wanted demonstration."""


@dataclass(frozen=True)
class Disturbance:
    """Pushes a demonstrator off its way, so that a clone of it learns to recover (DART, Laskey et al., CoRL 2017).

    At each free step a push begins with probability ``start``; it adds one Gaussian draw to the action, in units of
    half the action's range, for 1 to ``max_hold`` steps.

    Args:
        start: probability per step.
        max_hold: longest push in steps.
        std: standard deviation of a push.

    Raises:
        ValueError: if a value is out of range.

    Examples:
        >>> pushes = Disturbance(start=0.5).sample(10, 4)
        >>> pushes.shape
        torch.Size([10, 4, 2])
    """

    start: float = 0.1
    max_hold: int = 5
    std: float = 0.5

    def __post_init__(self) -> None:
        if not (0 <= self.start <= 1 and self.max_hold >= 1 and self.std >= 0):
            raise ValueError(f"A disturbance needs 0 <= start <= 1, max_hold >= 1 and std >= 0, got {self}.")

    def sample(
        self, steps: int, num_envs: int, num_actions: int = 2, generator: torch.Generator | None = None
    ) -> Tensor:
        """What to add to the normalised actions of whole episodes, ``[steps, num_envs, num_actions]``; mostly 0."""
        begins = torch.rand(steps, num_envs, generator=generator) < self.start
        holds = torch.randint(1, self.max_hold + 1, (steps, num_envs), generator=generator)
        pushes = self.std * torch.randn(steps, num_envs, num_actions, generator=generator)
        left = torch.zeros(num_envs, dtype=torch.long)
        for step in range(steps):
            begins_now = begins[step] & (left == 0)
            left = torch.where(begins_now, holds[step], left)
            held = pushes[step - 1] if step else torch.zeros_like(pushes[0])
            push = torch.where(begins_now.unsqueeze(-1), pushes[step], held)
            pushes[step] = push * (left > 0).unsqueeze(-1)
            left = (left - 1).clamp_min(0)
        return pushes


@torch.no_grad()
def record_demonstrations(
    policy: Callable[[Tensor], Tensor],
    sampler: Callable[..., Scene],
    num: int,
    *,
    world: World | None = None,
    disturbance: Disturbance | None = None,
    objectives: Mapping[str, Objective] | None = None,
    observe_human: bool = True,
    seed: int = 0,
    max_steps: int = 250,
    num_envs: int = 256,
) -> tuple[TensorDict, int]:
    """Roll a demonstrator out in random scenes and keep the episodes that reach the goal (Sec. III-C, III-D.3).

    The transitions lie flat, ordered by ``episode`` and ``step``: behaviour cloning draws rows, a replay buffer with
    ``SliceSampler(traj_key="episode", slice_len=25)`` draws snippets to rank. Off-policy learning takes
    ``executed_action`` as its action. A row holds all that a :class:`~morlnav.navigation.envs.Transition` needs, so
    that other objectives can be computed later.

    ==========================================  ========  =======================================================
    ``observation``                             ``[34]``  before the step, raw; ``[32]`` without the human
    ``action``                                  ``[2]``   what the demonstrator wanted: the label (m/s, rad/s)
    ``executed_action``                         ``[2]``   what was done, which differs during a disturbance
    ``pose``                                    ``[3]``   before the step, x, y (m) and heading (rad)
    ``scene.start|goal|human|boxes``                      see :class:`~morlnav.navigation.world.Scene`
    ``episode``, ``step``                       ``[]``    counted from 0
    ``next.observation|pose``                             after the step
    ``next.reward``                             ``[m]``   one entry per objective, unscaled
    ``next.outcome.*|terminated|done``          ``[1]``   as in :class:`~morlnav.navigation.envs.NavigationEnv`
    ==========================================  ========  =======================================================

    Args:
        policy: maps raw observations ``[B, 34]`` to actions ``[B, 2]``; it sees the human in any case.
        sampler: called as ``sampler(n, device=..., generator=...)`` for ``n`` new scenes.
        num: episodes to keep.
        world: the engine; tensors by default.
        disturbance: pushes the robot; ``None`` to leave it alone.
        objectives: reward terms by name as for :class:`~morlnav.navigation.envs.NavigationEnv`.
        observe_human: whether the human's position is recorded (``-NH`` ablation).
        seed: of scenes and disturbances, which are the same for the same ``num`` and ``num_envs``; torch's global
            random state is left alone.
        max_steps: episodes longer than this are dropped.
        num_envs: episodes side by side.

    Returns:
        The transitions ``[N]`` of ``num`` episodes, in main memory, and the number of episodes tried for them.

    Raises:
        ValueError: if a number is below 1, or the policy hardly ever succeeds.

    Examples:
        >>> from morlnav.navigation.modules import CircumnavigationOracle
        >>> from morlnav.navigation.world import SceneSampler
        >>> data, tries = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 3, disturbance=Disturbance())
        >>> int(data["episode"].max()) + 1, tries >= 3
        (3, True)
    """
    check_at_least(1, num=num, max_steps=max_steps, num_envs=num_envs)
    world = world if world is not None else TensorWorld()
    generator = torch.Generator().manual_seed(seed)

    def attempt(batch: int, tries: int) -> TensorDict:
        env = NavigationEnv(world, sampler, objectives, num_envs=batch, seed=seed)
        pushes = None if disturbance is None else disturbance.sample(max_steps, batch, generator=generator)
        with eval_mode(policy):
            return roll_out(policy, env, sampler(batch, device=env.device, generator=generator), pushes, max_steps)

    advice = "make the scenes easier, the disturbance weaker or max_steps larger, or mend the policy"
    data, tries = keep_successes(attempt, num, num_envs, "episodes reached the goal", advice)
    return (data if observe_human else hide_human(data)), tries


def keep_successes(
    attempt: Callable[[int, int], TensorDict], num: int, num_envs: int, success: str, advice: str
) -> tuple[TensorDict, int]:
    """Try until ``num`` episodes have reached the goal, and keep these.

    Args:
        attempt: called as ``attempt(batch, tries)`` for that many episodes ``[batch, T]``, after so many tries.
        num: episodes to keep.
        num_envs: episodes side by side, at most.
        success: what a kept episode did, for the error's sentence.
        advice: what to do where hardly any succeeds.

    Returns:
        The transitions ``[N]``, ordered by ``episode`` and ``step``, and the number of episodes tried for them.

    Raises:
        ValueError: if fewer than one in :data:`PATIENCE` succeeds.
    """
    kept, count, tries = [], 0, 0
    while count < num:
        if tries >= PATIENCE * num:
            raise ValueError(f"Only {count} of {tries} {success}, {num} are wanted; {advice}.")
        batch = min(num_envs, 2 * (num - count))
        episodes = attempt(batch, tries)
        driven, reached = successes(episodes)
        good = reached.nonzero().flatten()[: num - count]
        finished = len(good) == num - count
        tries += int(good[-1]) + 1 if finished else batch
        episodes["episode"][good] = torch.arange(count, count + len(good)).unsqueeze(1)
        kept.append(episodes[good][driven[good]])
        count += len(good)
    return torch.cat(kept), tries


def hide_human(data: TensorDict) -> TensorDict:
    """Take the human's position out of the observations of demonstrations ``[N]``, in place."""
    for key in ("observation", ("next", "observation")):
        data[key] = without_human(data[key])
    return data


def successes(episodes: TensorDict) -> tuple[Tensor, Tensor]:
    """Which steps of episodes ``[B, T]`` count, up to and including the one that ends it, and who reached the goal.

    Returns:
        ``bool`` ``[B, T]`` and ``[B]``.
    """
    done = episodes["next", "done"].squeeze(-1).long()
    driven = done.cumsum(1) == done
    return driven, (episodes["next", "outcome", "goal"].squeeze(-1) & driven).any(1)


def rewarded_transitions(data: TensorDict, objectives: Mapping[str, Objective], chunk: int = 65536) -> TensorDict:
    """Demonstrations as off-policy transitions, paid for by any objectives.

    Args:
        data: ``[N]``, as :func:`record_demonstrations` returns them; their observations hold the human's position.
        objectives: reward terms by name as for :class:`~morlnav.navigation.envs.NavigationEnv`.
        chunk: transitions that the objectives see at a time.

    Returns:
        ``[N]`` with ``observation``, ``pose``, ``scene``, ``action`` (as executed) and ``next`` with ``observation``,
        ``reward`` ``[m]``, ``done`` and ``terminated``, as a replay buffer takes them.

    Examples:
        >>> from morlnav.navigation.envs import default_objectives
        >>> from morlnav.navigation.modules import CircumnavigationOracle
        >>> from morlnav.navigation.world import SceneSampler
        >>> data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 2)
        >>> rows = rewarded_transitions(data, default_objectives())
        >>> torch.equal(rows["next", "reward"], data["next", "reward"])
        True
    """
    rewards = []
    for part in data.split(chunk):
        outcome = {name: part["next", "outcome", name].squeeze(-1) for name in ("human", "box", "goal")}
        transition = Transition(
            pose=part["pose"],
            next_pose=part["next", "pose"],
            action=part["executed_action"],
            observation=part["observation"],
            next_observation=part["next", "observation"],
            contact=Contact(**outcome, batch_size=part.batch_size),
            scene=Scene.from_tensordict(part["scene"]),
        )
        rewards.append(reward_vector(objectives, transition))
    following = data["next"].select("observation", "done", "terminated").set("reward", torch.cat(rewards))
    rows = data.select("observation", "pose", "scene").set("action", data["executed_action"])
    return rows.set("next", following)


def roll_out(
    policy: Callable[[Tensor], Tensor], env: NavigationEnv, scene: Scene, pushes: Tensor | None, max_steps: int
) -> TensorDict:
    """Episodes ``[B, T]`` in main memory; an episode that is done goes on unseen until all are."""
    low, high = (bound.to(env.device) for bound in (env.world.robot.action_low, env.world.robot.action_high))
    now = env.reset(scene=scene)
    running = torch.ones(len(scene), dtype=torch.bool, device=env.device)
    frames = []
    for step in range(max_steps):
        action = executed = policy(now["observation"])
        if pushes is not None:
            executed = (action + pushes[step].to(env.device) * (high - low) / 2).clamp(low, high)
        now = env.step(now.select("observation", "pose").set("action", executed))
        frame = now.select("observation", "pose", "next").set("action", action).set("executed_action", executed)
        frames.append(frame.clone())
        now = now["next"]
        running &= ~now["done"].squeeze(-1)
        if not running.any():
            break
    return as_episodes(frames, scene)


def as_episodes(frames: list[TensorDict], scene: Scene) -> TensorDict:
    """Steps ``[B]`` of episodes in scenes ``[B]`` side by side, ``[B, T]``, all with episode number 0."""
    episodes = torch.stack(frames, 1).to("cpu")
    size = episodes.batch_size
    episodes["scene"] = scene.to_tensordict().to("cpu").unsqueeze(1).expand(size)
    episodes["episode"] = torch.zeros(size, dtype=torch.long)
    episodes["step"] = torch.arange(size[1]).expand(size)
    return episodes


class OpenLoop:
    """Drives given actions whatever it sees, ``[B, T, 2]`` in m/s and rad/s, and stands still after them.

    >>> drive = OpenLoop(torch.tensor([[[0.5, 0.0]]]))
    >>> drive(torch.zeros(1, 34)), drive(torch.zeros(1, 34))
    (tensor([[0.5000, 0.0000]]), tensor([[0., 0.]]))
    """

    def __init__(self, actions: Tensor) -> None:
        self.actions = actions
        self.step = -1

    def __call__(self, observation: Tensor) -> Tensor:
        """Actions ``[B, 2]`` of the next step."""
        self.step += 1
        if self.step >= self.actions.shape[1]:
            return torch.zeros_like(self.actions[:, 0]).to(observation)
        return self.actions[:, self.step].to(observation)
