"""Social navigation as a batched TorchRL environment with a vector reward."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from morlnav.limits import check_at_least
from morlnav.navigation.envs.rewards import Objective, default_objectives, reward_bounds
from morlnav.navigation.envs.step import advance
from morlnav.navigation.world import Scene, SceneSampler, TensorWorld, World, without_human


class NavigationEnv(EnvBase):
    """A differential-drive robot passes a standing human toward a goal (Sec. III).

    Entries of the tensordict, all batched ``[*num_envs]`` and in raw units:

    ============================  =========  ==========================================================
    ``observation``               ``[34]``   goal distance (m) and bearing (rad), human distance and
                                             bearing, 30 lidar sectors (m); ``[32]`` without the human
    ``action``                    ``[2]``    linear velocity v (m/s), angular velocity ω (rad/s)
    ``reward``                    ``[m]``    one entry per objective, unscaled; static objectives first
    ``pose``                      ``[3]``    x, y (m) and heading (rad) in the world frame
    ``scene.start|goal|…``                   the scene, as of :class:`~morlnav.navigation.world.Scene`
    ``outcome.goal|human|box``    ``[1]``    whether the step ended at the goal or in contact
    ``terminated``, ``done``      ``[1]``    goal or contact; time limits are ``StepCounter``'s business
    ============================  =========  ==========================================================

    ``pose`` and ``scene`` are the whole state: ``env.reset(tensordict, set_state=True)`` goes on from there.
    Observations and rewards have a gradient in the actions, through as many steps as one likes.

    Args:
        world: the engine that moves robots, of which the environment takes a copy;
            :class:`~morlnav.navigation.world.TensorWorld` by default.
        scenes: called as ``scenes(n, device="cpu", generator=...)`` for as many new scenes as episodes have ended; if
            it does not tell its ``num_boxes``, for one scene more, to see them.
        objectives: reward terms by name, in order; those with ``static = True`` must come first.
        num_envs: environments side by side; ``None`` for one without a batch dimension.
        observe_human: whether the human's position is part of the observation (``-NH`` ablation).
        seed: seeds the scenes.
        inflation: by how many metres the robot is wider in training mode, as costmaps of planners inflate obstacles: a
            margin to learn with, for what a lidar's sector tells only roughly. After ``eval()`` it has its true size.

    Raises:
        ValueError: for an empty or wrongly ordered objective list, or ``num_envs < 1``; in a step, for an action that
            is not finite or an objective that returns anything but one finite reward per environment.

    Examples:
        >>> env = NavigationEnv(num_envs=4, seed=0)
        >>> rollout = env.rollout(3)
        >>> rollout["next", "reward"].shape
        torch.Size([4, 3, 3])
        >>> env.objectives
        ('distance', 'efficiency')
        >>> again = env.reset(rollout[:, 1].select("pose", "scene"), set_state=True)
        >>> torch.equal(again["observation"], rollout["observation"][:, 1])
        True
        >>> action = torch.full((4, 2), 0.1, requires_grad=True)
        >>> env.step(env.reset().set("action", action))["next", "reward"][:, 0].sum().backward()  # progress is made
        >>> (action.grad[:, 0] > 0).any().item()  # by driving on
        True
    """

    batch_locked = True
    _supports_set_state = True

    def __init__(
        self,
        world: World | None = None,
        scenes: Callable[..., Scene] | None = None,
        objectives: Mapping[str, Objective] | None = None,
        num_envs: int | None = None,
        observe_human: bool = True,
        seed: int | None = None,
        inflation: float = 0.0,
    ) -> None:
        check_at_least(1, num_envs=num_envs)
        check_at_least(0, inflation=inflation)
        self.world = copy.copy(world) if world is not None else TensorWorld()
        super().__init__(device=self.world.device, batch_size=[] if num_envs is None else [num_envs])
        self.scenes = scenes or SceneSampler()
        self.rewards = dict(objectives) if objectives is not None else default_objectives()
        if not self.rewards:
            raise ValueError("The environment needs at least one objective.")
        static = [getattr(term, "static", False) for term in self.rewards.values()]
        if static != sorted(static, reverse=True):
            raise ValueError(f"Static objectives must come before tuneable ones, got the order {list(self.rewards)}.")
        self.num_static = sum(static)
        self.observe_human = observe_human
        self._robots = {mode: _wider(self.world.robot, inflation * mode) for mode in (True, False)}
        self.train()
        self._count = num_envs or 1
        self._observation: Tensor | None = None
        self._make_spec()
        self.set_seed(seed if seed is not None else int(torch.empty((), dtype=torch.int64).random_().item()))

    @property
    def objectives(self) -> tuple[str, ...]:
        """Names of the tuneable objectives, in the order of the preference's entries."""
        return tuple(self.rewards)[self.num_static :]

    @property
    def reward_bounds(self) -> Tensor:
        """Least and largest reward of a step ``[2, m]``; infinite for objectives that do not tell."""
        reach = self.world.robot.max_speed * self.world.step_time
        return torch.tensor([reward_bounds(objective, reach) for objective in self.rewards.values()]).T

    @property
    def live(self) -> dict[str, Any]:
        """What networks, demonstrators and evaluations of this domain may ask for by naming an argument so."""
        world = self.world
        return {
            "world": world,
            "scenes": self.scenes,
            "observe_human": self.observe_human,
            "robot": world.robot,
            "max_turn": world.robot.action_high[1].item(),
            "step_time": world.step_time,
            "lidar_range": world.lidar.max_range,
            "sectors": world.lidar.sectors,
        }

    def train(self, mode: bool = True) -> NavigationEnv:
        """In training mode the robot is wider by ``inflation``."""
        self.world.robot = self._robots[mode]
        return super().train(mode)

    def to(self, device: torch.device | str) -> NavigationEnv:
        """Move world and specs; episodes begin anew."""
        self.world.to(device)
        return super().to(device)

    def _make_spec(self) -> None:
        shape = self.batch_size
        lidar = self.world.lidar

        def bounded(low: Tensor, high: Tensor) -> Bounded:
            return Bounded(low.expand(*shape, -1), high.expand(*shape, -1), device=self.device, dtype=torch.float32)

        low = torch.tensor([0.0, -torch.pi] * (1 + self.observe_human) + [0.0] * lidar.sectors)
        high = torch.tensor([torch.inf, torch.pi] * (1 + self.observe_human) + [lidar.max_range] * lidar.sectors)
        on_device = {"shape": shape, "device": self.device}
        flag = Binary(n=1, shape=(*shape, 1), device=self.device, dtype=torch.bool)
        outcome = Composite({name: flag.clone() for name in ("goal", "human", "box")}, **on_device)
        sizes = {"start": (3,), "goal": (2,), "human": (2,), "boxes": (self._num_boxes(), 5)}
        scene = {name: Unbounded(shape=(*shape, *size), device=self.device) for name, size in sizes.items()}
        pose = Unbounded(shape=(*shape, 3), device=self.device)
        self.state_spec = Composite(pose=pose, scene=Composite(scene, **on_device), **on_device)
        self.observation_spec = Composite(
            observation=bounded(low, high), outcome=outcome, **self.state_spec.clone(), **on_device
        )
        self.action_spec = bounded(self.world.robot.action_low, self.world.robot.action_high)
        self.reward_spec = Unbounded(shape=(*shape, len(self.rewards)), device=self.device)

    def _num_boxes(self) -> int:
        if hasattr(self.scenes, "num_boxes"):
            return self.scenes.num_boxes
        return self.scenes(1, device="cpu", generator=torch.Generator()).boxes.shape[-2]

    def _input_td_has_state(self, tensordict: TensorDictBase | None) -> bool:
        return False  # that somebody hands over is taken with set_state=True alone, as in all of TorchRL from 0.15 on

    def seen(self, observation: Tensor) -> Tensor:
        """What a policy sees of a whole observation ``[..., 34]``; ``[..., 32]`` without the human."""
        return observation if self.observe_human else without_human(observation)

    def _outputs(self, goal: Tensor, human: Tensor, box: Tensor) -> TensorDict:
        observation = self.seen(self._observation)
        done = (goal | human | box).unsqueeze(-1)
        out = TensorDict(
            {
                "observation": observation,
                "pose": self.world.pose.clone(),
                "scene": self.world.scene.to_tensordict(),
                "outcome": {"goal": goal.unsqueeze(-1), "human": human.unsqueeze(-1), "box": box.unsqueeze(-1)},
                "done": done,
                "terminated": done.clone(),
            },
            batch_size=[self._count],
            device=self.device,
        )
        return out

    def _reset(
        self,
        tensordict: TensorDictBase | None = None,
        *,
        scene: Scene | None = None,
        set_state: bool = False,
        **_: Any,
    ) -> TensorDict:
        """Begin new episodes; ``env.reset(scene=my_scenes)`` starts in given scenes, which are checked first.

        With ``set_state``, go on from the poses and scenes in ``tensordict``.
        """
        never = torch.zeros(self._count, dtype=torch.bool, device=self.device)
        if set_state:
            state = tensordict.select("pose", "scene").reshape(self._count)
            self.world.load_state_dict({"pose": state["pose"], **state["scene"].to_dict()})
            self._observation = self.world.observe()
            return self._outputs(never, never, never).reshape(self.batch_size)
        mask = tensordict.get("_reset", None) if tensordict is not None else None
        mask = mask.reshape(self._count) if mask is not None and self.world.scene is not None else None
        if scene is None:
            scene = self._draw(mask)
        else:
            scene = scene if scene.batch_size else scene.unsqueeze(0)
            if scene.batch_size != (self._count,):
                raise ValueError(f"Got {scene.batch_size[0]} scenes for {self._count} environments.")
            scene.check(self.world.robot.radius, self.world.human_radius)
        self.world.reset(scene, mask)
        self._observation = self.world.observe()
        return self._outputs(never, never, never).reshape(self.batch_size)

    def _draw(self, mask: Tensor | None) -> Scene:
        """New scenes for all environments, of which those outside ``mask`` are repetitions that nobody will see.

        They are drawn on the CPU, so one seed gives one sequence of scenes on any device. The count of ended episodes
        has to be known there, the one thing in this environment that a GPU is waited for.
        """
        if mask is None:
            return self.scenes(self._count, device="cpu", generator=self._generator)
        place = mask.cpu().cumsum(0)
        fresh = self.scenes(max(int(place[-1]), 1), device="cpu", generator=self._generator)
        return fresh[(place - 1).clamp_min(0)]

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = tensordict["action"].reshape(self._count, 2)
        transition, reward = advance(self.world, action, self._observation, self.rewards)
        self._observation, contact = transition.next_observation, transition.contact
        out = self._outputs(contact.goal, contact.human, contact.box)
        return out.set("reward", reward).reshape(self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self._generator = torch.Generator()
        self._generator.seed() if seed is None else self._generator.manual_seed(seed)

    def get_state(self) -> dict[str, Any]:
        """All that a bit-exact continuation needs: the world's state and the scene generator's."""
        return {"world": self.world.state_dict(), "generator": self._generator.get_state()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go on from a state that :meth:`get_state` returned."""
        self.world.load_state_dict(state["world"])
        self._generator.set_state(state["generator"])
        self._observation = self.world.observe()


def _wider(robot: Any, by: float) -> Any:
    """A copy of the robot with a larger radius; it may be frozen, or of a kind of its own."""
    robot = copy.copy(robot)
    object.__setattr__(robot, "radius", robot.radius + by)
    return robot
