"""What a policy earns under each preference, in any environment."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from morlnav.modules.mode import eval_mode


@torch.no_grad()
def discounted_returns(
    env: EnvBase,
    policy: TensorDictModuleBase,
    preferences: Tensor,
    max_steps: int,
    gamma: Tensor | float = 1.0,
    seed: int | None = None,
) -> Tensor:
    """Return vectors of one episode per environment of the batch and preference, without exploration.

    Args:
        env: keeps a preference handed to ``reset``, as one with :class:`~morlnav.transforms.DrawPreference` does;
            batched ``[E]`` or not.
        policy: writes ``action`` from ``observation`` and ``preference``; it is called in evaluation mode.
        preferences: λ, ``[P, n]``.
        max_steps: steps after which an episode is cut off.
        gamma: discount, one for all or one per entry of the reward ``[m]``.
        seed: of the environment before each preference, so that all meet the same episodes; ``None`` leaves it alone.

    Returns:
        ``[P, E, m]``.

    Examples:
        >>> from tensordict.nn import TensorDictModule
        >>> from torchrl.envs import TransformedEnv
        >>> from morlnav import NavigationEnv
        >>> from morlnav.data import UniformPreferences
        >>> from morlnav.transforms import DrawPreference
        >>> env = TransformedEnv(NavigationEnv(num_envs=4), DrawPreference(UniformPreferences(2)))
        >>> stand = TensorDictModule(lambda observation: observation[..., :2] * 0, ["observation"], ["action"])
        >>> discounted_returns(env, stand, torch.eye(2), max_steps=3)[..., 2].tolist()
        [[-30.0, -30.0, -30.0, -30.0], [-30.0, -30.0, -30.0, -30.0]]
    """
    with torch.random.fork_rng(), eval_mode(policy), set_exploration_type(ExplorationType.DETERMINISTIC):
        returns = [_returns(env, policy, preference, max_steps, gamma, seed) for preference in preferences]
    return torch.stack(returns)


def _returns(
    env: EnvBase,
    policy: TensorDictModuleBase,
    preference: Tensor,
    max_steps: int,
    gamma: Tensor | float,
    seed: int | None,
) -> Tensor:
    if seed is not None:
        env.set_seed(seed)
    given = TensorDict(batch_size=env.batch_size, device=env.device)
    given["preference"] = preference.to(env.device).expand(*env.batch_size, -1)
    rollout = env.rollout(
        max_steps,
        policy,
        auto_reset=False,
        tensordict=env.reset(given),
        break_when_any_done=False,
        break_when_all_done=True,
    )
    following = rollout["next"].reshape(-1, rollout.shape[-1])  # [E, T]
    done = following["done"]
    running = done.cumsum(1) - done.long() == 0  # the step that ends an episode is part of it
    reward = following["reward"]
    discounts = (
        torch.as_tensor(gamma, device=reward.device) ** torch.arange(done.shape[1], device=reward.device)[:, None]
    )
    return (reward * running * discounts).sum(1)


def eval_env(env: EnvBase) -> EnvBase:
    """An environment in evaluation mode, with what it wraps, which TorchRL's ``TransformedEnv.eval`` leaves as it is.

    Examples:
        >>> from morlnav import NavigationEnv
        >>> env = eval_env(TransformedEnv(NavigationEnv(inflation=0.1)))
        >>> env.base_env.world.robot.radius  # its true size
        0.18
    """
    if isinstance(env, TransformedEnv):
        eval_env(env.base_env)
    return env.eval()
