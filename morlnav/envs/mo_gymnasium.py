"""Continuous tasks of MO-Gymnasium, several episodes side by side."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers import DtypeObservation
from tensordict import TensorDictBase
from torchrl.envs import EnvBase
from torchrl.envs.libs.gym import MOGymWrapper, set_gym_backend

from morlnav.limits import check_at_least
from morlnav.sentences import nearest


def MOGymnasium(id: str, num_envs: int = 1) -> EnvBase:
    """A task of MO-Gymnasium by its id: TorchRL's ``MOGymWrapper`` around a Gymnasium vector of it.

    One vector is several times faster than as many of TorchRL's environments in a ``SerialEnv``. Observations are
    float32. Where the task's own time limit is reached, an episode is truncated and not terminated.

    Args:
        id: of a task with continuous, bounded actions, such as ``mo-hopper-2obj-v5``.
        num_envs: ``E`` of it side by side, each in an episode of its own.

    Returns:
        The environment, with batch size ``[E]``. Its attributes tell ``rewards``, the names of the entries of the
        reward (``objective_0`` and so on, if the task has no attribute of this name); ``reward_bounds``, least and
        largest reward of a step ``[2, m]``, infinite where the task does not know them; and ``max_steps``, the task's
        own time limit or ``None``.

    Raises:
        ValueError: if there is no such task, its actions are not continuous and bounded, or a package that it needs is
            not installed.

    Examples:
        >>> env = MOGymnasium("mo-mountaincarcontinuous-v0", num_envs=3)
        >>> env.rewards, env.max_steps, env.reward_bounds.tolist()
        (('objective_0', 'objective_1'), 999, [[-1.0, -1.0], [0.0, 0.0]])
        >>> env.rollout(5)["next", "reward"].shape
        torch.Size([3, 5, 2])
        >>> MOGymnasium("mo-hoper-2obj-v5")
        Traceback (most recent call last):
        ValueError: MO-Gymnasium has no task mo-hoper-2obj-v5; did you mean mo-hopper-2obj-v5?
    """
    check_at_least(1, num_envs=num_envs)
    with set_gym_backend("gymnasium"):
        return _Tasks(_Vector([lambda: _make(id)] * num_envs))


class _Tasks(MOGymWrapper):
    """TorchRL's wrapper of a vector, with what the tasks tell of themselves."""

    def __init__(self, env: _Vector, **settings: Any) -> None:
        super().__init__(env, **settings)
        task = env.envs[0]
        space = task.unwrapped.reward_space
        self.rewards = tuple(getattr(task.unwrapped, "rewards", [f"objective_{i}" for i in range(space.shape[0])]))
        self.max_steps: int | None = task.spec.max_episode_steps
        self.reward_bounds = torch.from_numpy(np.stack([space.low, space.high])).float()

    # TorchRL's own looks for a mask in whatever tensordict it gets, such as one with a preference alone.
    def _reset(self, tensordict: TensorDictBase | None = None, **settings: Any) -> TensorDictBase:
        given = None if tensordict is None else tensordict.get("_reset", None)
        mask = torch.ones(self.batch_size, dtype=torch.bool) if given is None else given.reshape(self.batch_size).cpu()
        return super()._reset(None, options={"reset_mask": mask.numpy()}, **settings)


class _Vector(SyncVectorEnv):
    """Gymnasium's, with a vector of rewards from each task, which goes on for whoever does not reset it.

    MO-Gymnasium's own resets episodes by itself, at a step in which the action is lost.
    """

    def __init__(self, makers: list[Callable[[], gymnasium.Env]]) -> None:
        super().__init__(makers, autoreset_mode=AutoresetMode.DISABLED)
        self.reward_space = batch_space(self.envs[0].unwrapped.reward_space, self.num_envs)
        self._rewards = np.zeros(self.reward_space.shape, np.float32)

    def step(self, actions: np.ndarray) -> tuple[Any, ...]:
        self._autoreset_envs[:] = False  # a roll-out goes on until all of its episodes have ended
        return super().step(actions)


def _make(id: str) -> gymnasium.Env:
    try:
        import mo_gymnasium
    except ImportError as error:
        raise ValueError("Tasks of MO-Gymnasium need it: pip install 'morlnav[mo]'.") from error
    tasks = [name for name, spec in gymnasium.registry.items() if _is_of(mo_gymnasium.__name__, spec)]
    if id not in tasks:
        raise ValueError(f"MO-Gymnasium has no task {id}; {nearest(id, tasks)}")
    try:
        with _quiet_mujoco("mujoco" in gymnasium.registry[id].entry_point), warnings.catch_warnings(action="ignore"):
            task = DtypeObservation(mo_gymnasium.make(id), np.float32)  # which warns that float32 is less than float64
    except (gymnasium.error.DependencyNotInstalled, ImportError) as error:
        raise ValueError(f"The task {id} needs a package that is not installed: {error}") from error
    _check(task, id)
    return task


def _is_of(package: str, spec: gymnasium.envs.registration.EnvSpec) -> bool:
    return isinstance(spec.entry_point, str) and spec.entry_point.startswith(f"{package}.")


@contextmanager
def _quiet_mujoco(needed: bool) -> Iterator[None]:
    """Keep notes to the authors of a model, which MuJoCo prints for every one of its environments, off the screen."""
    if not needed:
        yield
        return
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _check(task: gymnasium.Env, id: str) -> None:
    actions, observations = task.action_space, task.observation_space
    if not isinstance(actions, gymnasium.spaces.Box):
        raise ValueError(f"Actions must be continuous, but those of {id} are {actions}.")
    if not (np.isfinite(actions.low).all() and np.isfinite(actions.high).all()):
        raise ValueError(f"Actions need bounds, and those bounds must be finite, but those of {id} are {actions}.")
    if not isinstance(observations, gymnasium.spaces.Box) or len(observations.shape) != 1:
        raise ValueError(f"Observations must be vectors of numbers, but those of {id} are {observations}.")
