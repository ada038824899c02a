"""Ranked roll-outs of a clone under growing noise, and snippets to compare (Sec. III-C)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.envs import EnvBase, InitTracker, TransformedEnv

from morlnav.modules.mode import eval_mode


def roll_out_ranked(
    policy: Callable[[Tensor], Tensor],
    make_env: Callable[[int], EnvBase],
    make_noise: Callable[[Tensor], nn.Module],
    levels: Sequence[float],
    episodes: int,
    max_steps: int = 250,
) -> TensorDict:
    """Drive a policy under every noise level, all side by side, in any batched environment.

    Environments whose episode has ended begin another one, which is masked, until all have ended: not every simulator
    lets a part of its environments rest.

    Args:
        policy: maps observations ``[B, D]`` to actions ``[B, A]``.
        make_env: builds an environment of this many episodes side by side.
        make_noise: builds the noise for levels ``[B]``; called as ``noise(action, is_init, observation)``.
        levels: noise levels ε, ascending.
        episodes: roll-outs per level.
        max_steps: time limit.

    Returns:
        ``[levels, episodes, T]`` with ``observation``, ``action`` (as executed), ``reward`` ``[m]`` and ``mask``, true
        for real steps.

    Raises:
        ValueError: if the levels do not ascend from 0 or more, or there are no episodes.

    Examples:
        >>> from morlnav.navigation.envs import NavigationEnv
        >>> from morlnav.modules import EpsilonGreedyNoise
        >>> straight = lambda observation: torch.tensor([0.5, 0.0]).expand(len(observation), 2)
        >>> low, high = torch.tensor([0.0, -3.14]), torch.tensor([0.5, 3.14])
        >>> rollouts = roll_out_ranked(straight, lambda count: NavigationEnv(num_envs=count),
        ...     lambda levels: EpsilonGreedyNoise(levels, low, high), [0.0, 0.5, 1.0], episodes=4, max_steps=10)
        >>> rollouts.shape, rollouts["observation"].shape
        (torch.Size([3, 4, 10]), torch.Size([3, 4, 10, 34]))
    """
    if list(levels) != sorted(set(levels)) or not levels or levels[0] < 0 or episodes < 1:
        raise ValueError(f"Noise levels must ascend from 0 and need episodes, got {list(levels)} and {episodes}.")
    count = len(levels) * episodes
    env = TransformedEnv(make_env(count), InitTracker(), auto_unwrap=True)
    noise = make_noise(torch.tensor(levels, device=env.device).repeat_interleave(episodes))

    def act(tensordict: TensorDict) -> TensorDict:
        action = policy(tensordict["observation"])
        return tensordict.set("action", noise(action, tensordict["is_init"], tensordict["observation"]))

    state, steps = env.reset(), []
    running = torch.ones(count, dtype=torch.bool, device=env.device)
    with torch.no_grad(), eval_mode(policy):
        for _ in range(max_steps):
            step, state = env.step_and_maybe_reset(act(state))
            entries = {"reward": step["next", "reward"], "mask": running}
            steps.append(step.select("observation", "action").update(entries).clone())
            running = running & ~step["next", "done"].squeeze(-1)
            if (~running).all():
                break
    return torch.stack(steps, 1).reshape(len(levels), episodes, -1)


class SnippetPairs:
    """Draws pairs of equally long snippets, the better one from roll-outs with less noise.

    Starts are random and independent: D-REX's rule that the better snippet starts later would teach progress along the
    path instead of its shape. Snippets of a second tell where on the path a robot went astray; long ones blur that.
    Roll-outs of all levels begin alike, and noise takes a while to lead anywhere: the beginning of a worse one is no
    example of what is worse, and would only teach that whatever comes late is better.

    Args:
        rollouts: ``[levels, episodes, T]`` from :func:`roll_out_ranked`, noise ascending.
        length: steps of a snippet; ``None`` for whole roll-outs, padded and masked.
        burn_in: steps at the beginning of the worse roll-out that are left out; of one that ends before, only its last
            snippet is drawn.

    Raises:
        ValueError: if there are fewer than two levels, a level has no roll-out as long as a snippet, or the burn-in is
            negative, or one of whole roll-outs.

    Examples:
        >>> rollouts = TensorDict(observation=torch.zeros(3, 4, 10, 34), action=torch.zeros(3, 4, 10, 2),
        ...     mask=torch.ones(3, 4, 10, dtype=torch.bool), batch_size=[3, 4, 10])
        >>> SnippetPairs(rollouts, length=5).sample(16)["better", "action"].shape
        torch.Size([16, 5, 2])
    """

    def __init__(self, rollouts: TensorDict, length: int | None = 5, burn_in: int = 0) -> None:
        if burn_in < 0 or (burn_in and length is None):
            raise ValueError(f"burn_in must be 0 or more, and 0 for whole roll-outs, got {burn_in}.")
        self.rollouts, self.length, self.burn_in = rollouts, length, burn_in
        self.steps = rollouts["mask"].sum(-1)
        self.valid = (self.steps >= (length or 1)).float()
        if len(rollouts) < 2:
            raise ValueError("Ranking needs at least two noise levels.")
        if not self.valid.any(1).all():
            raise ValueError(f"A noise level has no roll-out of {length} steps; shorten the snippets.")

    def sample(self, num: int) -> TensorDict:
        """``num`` pairs: ``better`` and ``worse``, each with ``observation`` and ``action`` ``[num, L, ...]``."""
        count = len(self.rollouts)
        first = torch.randint(count, (num,), device=self.steps.device)
        other = (first + torch.randint(1, count, (num,), device=self.steps.device)) % count
        low, high = torch.minimum(first, other), torch.maximum(first, other)
        return TensorDict(better=self._cut(low), worse=self._cut(high, self.burn_in), batch_size=[num])

    def _cut(self, level: Tensor, after: int = 0) -> TensorDict:
        episode = torch.multinomial(self.valid[level], 1).squeeze(-1)
        rows = self.rollouts.select("observation", "action", "mask")
        if self.length is None:
            return rows[level, episode].auto_batch_size_(1)
        room = self.steps[level, episode] - self.length + 1
        first = (room - 1).clamp(max=after)
        start = first + (torch.rand(len(level), device=room.device) * (room - first)).long()
        time = start.unsqueeze(1) + torch.arange(self.length, device=room.device)
        return rows[level.unsqueeze(1), episode.unsqueeze(1), time].auto_batch_size_(1)
