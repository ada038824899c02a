"""Environment steps per second with a scan of 720 rays, over the number of environments side by side."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from functools import partial

import numpy as np
import torch
from torch import Tensor

from benchmarks.timing import Contender, Effort, NotAvailable, Row, race
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.world import PymunkWorld, SceneSampler, TensorWorld, World
from morlnav.navigation.world.pymunk import ROBOT_FILTER

TITLE = "Simulation: one robot's step with a scan of 720 rays over 4 m"
NOTES = """Unit: steps of single robots, each with one scan of 720 rays. `NavigationEnv` computes motion, contact
checked four times per step, the scan of a human and three rotated boxes, rewards and the observation, and begins
finished episodes anew; robots steer toward their goals. *Engine alone* is motion, contact and observation. Its scan
gives the least reading of each of 30 sectors, the same numbers as casting all 720 rays; rays that cannot be the
nearest of their sector need not be cast for that, and *every ray cast* casts them nevertheless. VMAS `navigation`
gives all 720 readings of discs, one or four other agents (a step of `n` agents counts as `n`), and computes motion
with collisions, rewards and observations, without new episodes. JaxNav (JaxMARL) walks all 720 rays through an
occupancy grid in steps of 5 cm, with one agent. The plain pymunk loop does nothing but 720 segment queries among a
human and three boxes."""

RAYS, REACH = 720, 4.0
LARGEST = {"pymunk": 64, "jaxnav": 1024, "vmas with four": 1024}
"""Batches beyond these take seconds per step."""


def measure(effort: Effort) -> list[Row]:
    """Race all simulators at every batch size."""
    rows = []
    for batch in effort.batches:
        contenders = [
            Contender(f"NavigationEnv, {name} engine", partial(drive, world, batch), batch)
            for name, world in engines(effort.device).items()
        ]
        for engine, name in ((TensorWorld, "tensor engine alone"), (EveryRay, "tensor engine alone, every ray cast")):
            contenders.append(Contender(name, partial(_engine_alone, engine, batch, effort.device), batch))
        contenders += _peers(batch, effort.device)
        rows += race("simulation", f"batch {batch}", "steps/s", contenders, effort, size=batch)
    return rows


def engines(device: str) -> dict[str, Callable[[], World]]:
    """The batched engine in every form that it offers."""
    return {"tensor": partial(TensorWorld, device=device)}


def _peers(batch: int, device: str) -> list[Contender]:
    peers = [
        Contender("VMAS navigation, one other body", partial(_vmas, batch, 2, device), 2 * batch, peer=True),
        _limited("VMAS navigation, four other bodies", partial(_vmas, batch, 5, device), 5 * batch, "vmas with four"),
    ]
    if torch.device(device).type != "cpu":
        return peers
    return [
        _limited("NavigationEnv, pymunk engine", partial(drive, PymunkWorld, batch), batch, "pymunk"),
        _limited("plain pymunk ray loop", partial(_ray_loop, batch), batch, "pymunk"),
        *peers,
        _limited("JaxNav", partial(_jaxnav, batch), batch, "jaxnav"),
    ]


def _limited(name: str, build: Callable[[], Callable[[], object]], work: int, limit: str) -> Contender:
    def too_slow() -> Callable[[], object]:
        raise NotAvailable("not measured: seconds per step")

    batch = build.args[1] if build.func is drive else build.args[0]
    return Contender(name, too_slow if batch > LARGEST[limit] else build, work, peer=build.func is not drive)


def drive(world: Callable[[], World], batch: int, scenes: SceneSampler | None = None) -> Callable[[], object]:
    """One step of ``batch`` environments whose robots steer toward their goals; finished episodes begin anew."""
    env = NavigationEnv(world(), scenes, num_envs=batch, seed=0)
    state = env.reset()

    def step() -> None:
        nonlocal state
        state["action"] = _toward_goal(state["observation"])
        _, state = env.step_and_maybe_reset(state)

    return step


def _toward_goal(observation: Tensor) -> Tensor:
    return torch.stack([torch.full_like(observation[:, 1], 0.5), observation[:, 1].clamp(-1, 1)], -1)


class EveryRay(TensorWorld):
    """The batched engine without its shortcut in the scan."""

    def scan(self) -> Tensor:
        """All 720 readings, then the least of every sector."""
        return self.lidar.pool(self.lidar.cast(self.pose, self.scene.human, self.scene.boxes, self.human_radius))


def _engine_alone(engine: type[TensorWorld], batch: int, device: str) -> Callable[[], object]:
    world = engine(device=device)
    scenes = SceneSampler()(batch, device=world.device, generator=torch.Generator().manual_seed(0))
    world.reset(scenes)
    share = torch.rand(batch, 1, generator=torch.Generator().manual_seed(0)).to(world.device)
    places = scenes.start.clone()
    places[:, :2] = scenes.start[:, :2].lerp(scenes.goal, share)  # all along the way, as in an episode
    action = torch.tensor([0.5, 0.1], device=world.device).expand(batch, 2)

    def step() -> None:
        world.pose = places
        world.step(action)
        world.observe()

    return step


def _ray_loop(batch: int) -> Callable[[], object]:
    world = PymunkWorld()
    scene = SceneSampler()(1, generator=torch.Generator().manual_seed(0))
    space, start = world.build_space(scene[0]), tuple(scene.start[0, :2].tolist())
    ends = [
        (start[0] + REACH * math.cos(2 * math.pi * i / RAYS), start[1] + REACH * math.sin(2 * math.pi * i / RAYS))
        for i in range(RAYS)
    ]

    def step() -> None:
        for _ in range(batch):
            hits = [space.segment_query_first(start, end, 0, ROBOT_FILTER) for end in ends]
            np.array([1.0 if hit is None else hit.alpha for hit in hits]).reshape(30, -1).min(1)

    return step


def _vmas(batch: int, agents: int, device: str) -> Callable[[], object]:
    with _hushed():
        import vmas

    env = vmas.make_env(
        "navigation", num_envs=batch, n_agents=agents, lidar_range=REACH, n_lidar_rays=RAYS, device=device, seed=0
    )
    env.reset()
    actions = [0.1 * torch.randn(batch, 2, device=device) for _ in range(agents)]

    @torch.no_grad()
    def step() -> None:
        env.step(actions)

    return step


def _jaxnav(batch: int) -> Callable[[], object]:
    with _hushed():
        import jax
        import jaxmarl

        env = jaxmarl.make("jaxnav", num_agents=1, lidar_num_beams=RAYS, lidar_max_range=REACH)
        keys = jax.random.split(jax.random.PRNGKey(0), batch)
        _, state = jax.jit(jax.vmap(env.reset))(keys)
        actions = {"agent_0": jax.numpy.full((batch, 2), 0.1)}
        advance = jax.jit(jax.vmap(env.step_env))
        advance(keys, state, actions)  # compiles, with warnings

    def step() -> None:
        nonlocal state
        _, state, *rest = advance(keys, state, actions)
        jax.block_until_ready(rest)

    return step


@contextmanager
def _hushed() -> Iterator[None]:
    """Swallow what the peers say while they are imported and built."""
    with warnings.catch_warnings(action="ignore"), redirect_stdout(io.StringIO()):
        yield
