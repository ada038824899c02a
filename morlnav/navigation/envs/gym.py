"""The environment for Gymnasium and MO-Gymnasium: one robot, or many side by side, with a vector reward.

Gymnasium knows it as ``morlnav/SocialNavigation-v0`` (:mod:`morlnav.navigation.registration`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import Bounded

from morlnav.navigation.envs.navigation import NavigationEnv
from morlnav.navigation.registration import MAX_EPISODE_STEPS
from morlnav.navigation.world import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class SocialNavigation(gymnasium.Env[np.ndarray, np.ndarray]):
    """:class:`NavigationEnv` with Gymnasium's interface: ``float32`` arrays, and one reward entry per objective.

    ``reward_space`` and ``reward_dim`` are what MO-Gymnasium and morl-baselines look for. ``info`` holds the pose
    ``[3]`` (m, m, rad), the scene, and how an episode ended: ``goal``, ``human`` and ``box``, each ``bool``.

    Args:
        render_mode: ``"rgb_array"``, or ``"human"`` for a window; both are drawn with matplotlib.
        settings: arguments of :class:`NavigationEnv`, such as ``objectives`` or ``world``.

    Raises:
        ValueError: for an unknown render mode.

    Examples:
        >>> import gymnasium, morlnav
        >>> env = gymnasium.make("morlnav/SocialNavigation-v0")
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((34,), (3,))
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 5}  # noqa: RUF012  (Gymnasium's attribute)

    def __init__(self, render_mode: str | None = None, **settings: Any) -> None:
        self.render_mode = _checked(render_mode, self.metadata["render_modes"])
        self._env = NavigationEnv(num_envs=1, **settings)
        self.observation_space, self.action_space, self.reward_space = _spaces(self._env)
        self.reward_dim = len(self._env.rewards)
        self.objectives = tuple(self._env.rewards)
        self._track: list[Tensor] = []
        self._figure: Figure | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode; ``options={"scene": scene}`` begins it in a given scene.

        Raises:
            ValueError: if the given scene is impossible.
        """
        super().reset(seed=seed)
        if seed is not None:
            self._env.set_seed(seed)
        state = self._env.reset(**(options or {})).cpu()
        self._track = [state["pose"][0, :2]]
        self._show()
        return state["observation"][0].numpy(), _info(state, 0)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool, bool, dict[str, Any]]:
        """Drive for one control step with ``action`` ``(v, ω)`` in m/s and rad/s."""
        batch = TensorDict({"action": torch.as_tensor(np.asarray(action, np.float32)).reshape(1, 2)}, [1])
        state = self._env.step(batch.to(self._env.device))["next"].cpu()
        self._track.append(state["pose"][0, :2])
        self._show()
        reward = state["reward"][0].numpy()
        return state["observation"][0].numpy(), reward, bool(state["terminated"]), False, _info(state, 0)

    def render(self) -> np.ndarray | None:
        """The scene from above, as an image ``[H, W, 3]`` of ``uint8``; ``None`` without that render mode."""
        if self.render_mode != "rgb_array":
            return None
        from morlnav.navigation.record.frames import render_frame  # only who draws pays for matplotlib

        return render_frame(self._env.world, 0, self._track)

    def _show(self) -> None:
        if self.render_mode != "human":
            return
        from matplotlib import pyplot as plt  # looks for a screen

        from morlnav.navigation.record.frames import draw_state

        if self._figure is None:
            self._figure = plt.figure("morlnav", figsize=(5, 5))
        self._figure.clear()
        draw_state(self._figure, self._env.world, 0, self._track)
        plt.pause(1 / self.metadata["render_fps"])

    def close(self) -> None:
        """Close the window."""
        if self._figure is not None:
            from matplotlib import pyplot as plt

            plt.close(self._figure)
            self._figure = None


class SocialNavigationVector(gymnasium.vector.VectorEnv):
    """Many robots in one batched world, with Gymnasium's vector interface; rewards are ``[num_envs, m]``.

    Args:
        num_envs: robots side by side.
        max_episode_steps: time limit of an episode; ``None`` for none.
        render_mode: ``"rgb_array"``, drawn with matplotlib.
        autoreset_mode: when an ended environment begins anew: ``"NextStep"``, at the next step; ``"SameStep"``, at
            once, with its last observation in ``info["final_obs"]``; or ``"Disabled"``, by ``reset`` with
            ``options={"reset_mask": mask}``. TorchRL's ``GymWrapper`` takes the latter two.
        settings: arguments of :class:`NavigationEnv`, such as ``objectives`` or ``world``.

    Raises:
        ValueError: for an unknown render mode or autoreset mode.

    Examples:
        >>> import gymnasium, morlnav
        >>> envs = gymnasium.make_vec("morlnav/SocialNavigation-v0", num_envs=4)
        >>> observation, _ = envs.reset(seed=0)
        >>> envs.step(envs.action_space.sample())[1].shape
        (4, 3)
    """

    metadata = {  # noqa: RUF012  (Gymnasium's attribute)
        "autoreset_mode": AutoresetMode.NEXT_STEP,  # of an instance: its own
        "render_modes": ["rgb_array"],
        "render_fps": SocialNavigation.metadata["render_fps"],
    }

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **settings: Any,
    ) -> None:
        self.render_mode = _checked(render_mode, self.metadata["render_modes"])
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._env = NavigationEnv(num_envs=num_envs, **settings)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space, self._reward_space = _spaces(self._env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.reward_dim = len(self._env.rewards)
        self.objectives = tuple(self._env.rewards)
        self.max_episode_steps = max_episode_steps
        self._steps = np.zeros(num_envs, int)
        self._ended = np.zeros(num_envs, bool)
        self._tracks: list[list[Tensor]] = [[] for _ in range(num_envs)]

    @property
    def reward_space(self) -> spaces.Box:
        """Space of one environment's reward ``[m]``, as in MO-Gymnasium's vectors."""
        return self._reward_space

    def get_wrapper_attr(self, name: str) -> Any:
        """The attribute ``name``; TorchRL's ``GymWrapper`` asks so for the reward's space, and wants the batch's."""
        return batch_space(self._reward_space, self.num_envs) if name == "reward_space" else getattr(self, name)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict]:
        """Begin an episode in every environment.

        Args:
            seed: one number for all; or one for each, which then begins in the scene of that seed alone.
            options: ``scene``, given scenes to begin in; ``reset_mask``, ``bool`` ``[num_envs]``, the environments to
                begin anew while the others stay where they are.

        Raises:
            ValueError: if a given scene is impossible, or the number of seeds or the mask does not fit.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", np.ones(self.num_envs, bool))
        if np.shape(mask) != (self.num_envs,) or not np.any(mask):
            raise ValueError(f"reset_mask needs {self.num_envs} flags, at least one of them true, got {mask}.")
        if np.ndim(seed):
            options = {"scene": self._scenes_of(seed), **options}
            seed = int(np.random.SeedSequence([number for number in seed if number is not None]).generate_state(1)[0])
        super().reset(seed=seed)
        if seed is not None:
            self._env.set_seed(seed)
        state = self._begin(mask, **options)
        self._steps[mask], self._ended[mask] = 0, False
        self._record(state["pose"])
        return state["observation"].numpy(), _info(state)

    def _scenes_of(self, seeds: Sequence[int | None]) -> Scene:
        if len(seeds) != self.num_envs:
            raise ValueError(f"Got {len(seeds)} seeds for {self.num_envs} environments.")

        def scene(seed: int | None) -> Scene:
            generator = torch.Generator()
            generator.seed() if seed is None else generator.manual_seed(seed)
            return self._env.scenes(1, device="cpu", generator=generator)

        return torch.cat([scene(seed) for seed in seeds])

    def _begin(self, mask: np.ndarray, **options: Any) -> TensorDict:
        """The state of all environments after those of the mask ``[num_envs]`` have begun an episode."""
        begins = TensorDict({"_reset": torch.from_numpy(mask).unsqueeze(-1)}, [self.num_envs])
        # reset() itself says nothing of those that go on.
        return self._env._reset(None if mask.all() else begins.to(self._env.device), **options).cpu()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive every robot for one control step; where an episode ends, ``autoreset_mode`` says what follows.

        Raises:
            ResetNeeded: if an environment has ended that ``autoreset_mode="Disabled"`` leaves to the user.
        """
        began, next_step = self._ended, self.autoreset_mode is AutoresetMode.NEXT_STEP
        if began.any() and not next_step:
            raise ResetNeeded(f"Reset the environments {began.nonzero()[0].tolist()} first: their episodes have ended.")
        batch = TensorDict({"action": torch.as_tensor(np.asarray(actions, np.float32))}, [self.num_envs])
        state = self._env.step(batch.to(self._env.device))["next"].cpu()
        if began.any():  # the step that begins an episode has no reward
            state = self._begin(began).where(torch.from_numpy(began), state, pad=0)
        terminated = state["terminated"].squeeze(-1).numpy()
        self._steps = np.where(began, 0, self._steps + 1)
        late = self.max_episode_steps is not None and self._steps >= self.max_episode_steps
        truncated = late & ~terminated
        self._ended = ended = terminated | truncated
        reward, info = state["reward"].numpy(), _info(state)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            last = np.full(self.num_envs, None, object)
            for index in ended.nonzero()[0]:
                last[index] = state["observation"][index].numpy()
            state = self._begin(ended)
            info = _info(state) | {"final_obs": last, "_final_obs": ended, "final_info": info, "_final_info": ended}
            self._steps[ended], self._ended = 0, np.zeros(self.num_envs, bool)
        self._record(state["pose"])
        return state["observation"].numpy(), reward, terminated, truncated, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Every scene from above, as images ``[H, W, 3]`` of ``uint8``; ``None`` without a render mode."""
        if self.render_mode is None:
            return None
        from morlnav.navigation.record.frames import render_frame

        return tuple(render_frame(self._env.world, index, track) for index, track in enumerate(self._tracks))

    def _record(self, poses: Tensor) -> None:
        if self.render_mode is None:
            return
        for index, (step, pose) in enumerate(zip(self._steps, poses, strict=True)):
            self._tracks[index] = [*self._tracks[index][:step], pose[:2]]


def _checked(render_mode: str | None, modes: list[str]) -> str | None:
    if render_mode not in (None, *modes):
        raise ValueError(f"render_mode must be one of {modes}, got {render_mode}.")
    return render_mode


def _spaces(env: NavigationEnv) -> tuple[spaces.Box, spaces.Box, spaces.Box]:
    """Spaces of one environment's observation, action and reward."""

    def box(spec: Bounded) -> spaces.Box:
        return spaces.Box(spec.space.low[0].cpu().numpy(), spec.space.high[0].cpu().numpy(), dtype=np.float32)

    low, high = env.reward_bounds.numpy()
    return box(env.observation_spec["observation"]), box(env.action_spec), spaces.Box(low, high, dtype=np.float32)


def _info(state: TensorDict, index: int | None = None) -> dict[str, Any]:
    ends = {name: state["outcome", name].squeeze(-1) for name in ("goal", "human", "box")}
    if index is None:
        return {"pose": state["pose"].numpy(), **{name: flag.numpy() for name, flag in ends.items()}}
    scene = {name: value[index].numpy() for name, value in state["scene"].items()}
    return {"pose": state["pose"][index].numpy(), "scene": scene, **{name: bool(f[index]) for name, f in ends.items()}}
