"""Behaviours that a demonstration reward has to tell from the demonstration, though most of them reach the goal too."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from morlnav.navigation.envs import Objective
from morlnav.navigation.evaluation.paths import evenly
from morlnav.navigation.evaluation.rollout import Rollouts, evaluate_policy
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import Scene, TensorWorld, World
from morlnav.navigation.world.geometry import to_frame

RADII = (0.6, 0.75, 1.35, 1.6, 2.0, 2.5)
"""Radii in metres of orbits that are not the demonstrated one."""


@dataclass(frozen=True)
class Behaviour:
    """A way to drive, and how to roll it out.

    Args:
        policy: maps observations ``[B, 34]`` and preferences ``[B, n]`` to actions ``[B, 2]``.
        max_steps: episodes longer than this time out.
        arrives: whether it means to reach the goal; one that does not is judged by how long it gets away with it.
        has_memory: whether the policy keeps a state per scene, so that finished episodes must stay in the batch.

    Examples:
        >>> from morlnav.navigation.evaluation import evaluation_scenes
        >>> idle = Behaviour(lambda observation, preference: torch.zeros(len(observation), 2), max_steps=5)
        >>> idle.drive(evaluation_scenes(3)).steps
        tensor([[5, 5, 5]])
    """

    policy: Callable[[Tensor, Tensor], Tensor]
    max_steps: int = 500
    arrives: bool = True
    has_memory: bool = False

    def drive(
        self, scenes: Scene, *, world: World | None = None, objectives: Mapping[str, Objective] | None = None
    ) -> Rollouts:
        """One episode in each of the scenes ``[S]``, as roll-outs batched ``[1, S]``; see :func:`evaluate_policy`."""
        tuneable = 2 if objectives is None else sum(not getattr(term, "static", False) for term in objectives.values())
        return evaluate_policy(
            self.policy,
            scenes,
            torch.full((1, tuneable), 1 / max(tuneable, 1)),
            world=world,
            objectives=objectives,
            max_steps=self.max_steps,
            drop_finished=not self.has_memory,
        )


def alternative_behaviours(scenes: Scene, max_steps: int = 250, world: World | None = None) -> dict[str, Behaviour]:
    """Alternatives to the demonstration of Sec. III-D.3: too tight, too wide, too late, mirrored, slow or idle.

    ====================================  =============================================================================
    ``radius 0.6`` … ``radius 2.5``       the demonstration's pattern on smaller and larger circles, see :data:`RADII`
    ``wrong side``                        its mirror image, counter-clockwise, with the human on the left
    ``swerve 0.55``                       straight on, and round the human at 0.55 m from 1 m before on
    ``taut 1.0``, ``taut 1.6``            the shortest path outside a circle of that radius, human on the right
    ``half speed``                        the demonstration at half the speed
    ``extra loop``                        the demonstration, once more around the human
    ``idle``, ``spin``                    stay at the start, without or with turning on the spot
    ====================================  =============================================================================

    Boxes are ignored, as the demonstration does: judge only scenes without a collision.

    Args:
        scenes: batched ``[S]``; behaviours that follow a path know these scenes alone.
        max_steps: time limit of an episode, which idling and spinning use up; the others may take twice as long.
        world: whose robot drives, and whose lidar it has; that of the paper by default.

    Examples:
        >>> from morlnav.navigation.evaluation import evaluation_scenes
        >>> suite = alternative_behaviours(evaluation_scenes(2))
        >>> len(suite), suite["idle"].arrives
        (14, False)
    """

    world = world or TensorWorld()
    robot, sectors = world.robot, world.lidar.sectors
    drive = {"speed": robot.max_speed, "max_turn": robot.max_turn, "step_time": world.step_time}

    def oracle(**settings: float) -> Behaviour:
        policy = CircumnavigationOracle(**drive | {"sectors": sectors} | settings)
        return Behaviour(lambda observation, _: policy(observation), 2 * max_steps)

    def follow(**shape: float) -> Behaviour:
        follower = PathFollower(scenes, paths_around(scenes, **shape), **drive).to(world.device)
        return Behaviour(follower, 2 * max_steps, has_memory=True)

    def constant(speed: float, turn: float) -> Behaviour:
        action = torch.tensor([speed, turn])
        return Behaviour(lambda obs, _: action.to(obs).expand(len(obs), 2), max_steps, arrives=False)

    return {
        **{f"radius {radius}": oracle(radius=radius) for radius in RADII},
        "wrong side": oracle(clockwise=False),
        "swerve 0.55": follow(radius=0.55, reach=1.0),
        "taut 1.0": follow(radius=1.0),
        "taut 1.6": follow(radius=1.6),
        "half speed": oracle(speed=robot.max_speed / 2),
        "extra loop": follow(radius=1.0, taut=False, loops=1),
        "idle": constant(0.0, 0.0),
        "spin": constant(0.0, robot.max_turn),
    }


def paths_around(
    scenes: Scene,
    radius: float,
    *,
    taut: bool = True,
    loops: int = 0,
    reach: float = math.inf,
    points: int = 400,
) -> Tensor:
    """Paths from start to goal by way of a circle around the human, clockwise, so that the human is on the right.

    Args:
        scenes: batched ``[S]``.
        radius: of the circle in metres.
        taut: touch the circle as a string would; otherwise come straight from the start toward the human, and leave
            the circle straight toward the goal, with corners.
        loops: additional rounds.
        reach: a taut string leaves the lines to the human at this distance from the human's centre, in metres; by
            default at start and goal.
        points: on the circle.

    Returns:
        Polylines ``[S, points + 4, 2]`` in metres; neighbouring points may coincide.

    Examples:
        >>> from morlnav.navigation.evaluation import evaluation_scenes
        >>> scenes = evaluation_scenes(1)
        >>> distance = (paths_around(scenes, 1.0)[0] - scenes.human[0]).norm(dim=-1)
        >>> round(distance.min().item(), 3)
        1.0
    """
    arms = torch.stack([scenes.start[:, :2], scenes.goal]) - scenes.human  # from the human, [2, S, 2]
    length = arms.norm(dim=-1)
    arms = arms * (reach / length).clamp_max(1).unsqueeze(-1)
    first, last = torch.atan2(arms[..., 1], arms[..., 0])
    sweep = (first - last) % (2 * torch.pi)
    if taut:
        slack = (radius / length.clamp_max(reach)).clamp_max(1).acos()
        first, sweep = first - slack[0], (sweep - slack.sum(0)).clamp_min(0)
    share = torch.linspace(0, 1, points, device=first.device)
    angle = first.unsqueeze(1) - share * (sweep + 2 * torch.pi * loops).unsqueeze(1)
    arc = scenes.human.unsqueeze(1) + radius * torch.stack([angle.cos(), angle.sin()], -1)
    ends = scenes.human + arms if taut else arc[:, [0, -1]].transpose(0, 1)
    return torch.cat([scenes.start[:, None, :2], ends[0, :, None], arc, ends[1, :, None], scenes.goal[:, None]], 1)


class PathFollower(nn.Module):
    """A policy that drives along one given path per scene, however it winds.

    Pure pursuit: it drives the arc through a waypoint two control steps ahead, and turns on the spot where that point
    is not in front. Which waypoint comes next is its memory: all scenes must stay in the batch, in order. An episode
    begins anew wherever a robot stands at its scene's start.

    Args:
        scenes: batched ``[S]``.
        paths: polylines ``[S, L, 2]`` in metres, from start to goal.
        speed: in m/s.
        max_turn: largest angular velocity in rad/s, either way.
        step_time: one control step in seconds.

    Raises:
        ValueError: if there is not one path per scene.

    Examples:
        >>> from morlnav.navigation.evaluation import evaluation_scenes
        >>> scenes = evaluation_scenes(4)
        >>> follower = PathFollower(scenes, paths_around(scenes, 1.0))
        >>> rollouts = evaluate_policy(follower, scenes, torch.ones(1, 2), drop_finished=False)
        >>> rollouts.batch_size
        torch.Size([1, 4])
    """

    aim = math.pi / 6
    """Waypoints within this bearing are in front, in radians."""

    def __init__(
        self, scenes: Scene, paths: Tensor, speed: float = 0.5, max_turn: float = torch.pi, step_time: float = 0.2
    ) -> None:
        super().__init__()
        if scenes.batch_size != paths.shape[:1]:
            raise ValueError(f"Need one path for each of the {list(scenes.batch_size)} scenes, got {len(paths)}.")
        self.speed, self.max_turn, self.step_time = speed, max_turn, step_time
        axis = scenes.goal - scenes.human
        self.register_buffer("human", scenes.human)
        self.register_buffer("course", torch.atan2(axis[:, 1], axis[:, 0]))
        self.register_buffer(
            "start", (scenes.start[None, :, :2] - torch.stack([scenes.goal, scenes.human])).norm(dim=-1)
        )
        waypoints = [evenly(path, speed * step_time) for path in paths.double().cpu().numpy()]
        self.register_buffer("last", torch.tensor([len(line) - 1 for line in waypoints], device=paths.device))
        lines = [torch.from_numpy(line).to(paths) for line in waypoints]
        self.register_buffer("waypoints", nn.utils.rnn.pad_sequence(lines, batch_first=True))
        self.register_buffer("next", torch.zeros_like(self.last))

    @torch.no_grad()
    def forward(self, observation: Tensor, preference: Tensor | None = None) -> Tensor:
        """Actions ``[S, 2]`` (m/s, rad/s) for raw observations ``[S, 34]``; the preference is not looked at.

        Raises:
            ValueError: if the batch is not one robot per scene.
        """
        if len(observation) != len(self.last):
            raise ValueError(
                f"The follower has {len(self.last)} paths and got {len(observation)} robots; keep every scene in the "
                f"batch (drop_finished=False), under one preference."
            )
        distance, bearing = observation[:, [0, 2]].T, observation[:, [1, 3]].T
        goal, human = torch.stack([distance * bearing.cos(), distance * bearing.sin()], -1)
        heading = self.course - torch.atan2(*(goal - human).flip(-1).T)
        at_start = ((distance - self.start).abs() < 1e-3).all(0)
        self.next = torch.where(at_start, 0, self.next)

        lookahead = 2 * self.speed * self.step_time
        for _ in range(2):  # as far as the robot got in one step, and some more if it lags behind
            near = self._target(human, heading).norm(dim=-1) < lookahead
            self.next = torch.minimum(self.next + near, self.last)
        target = self._target(human, heading)
        angle = torch.atan2(target[:, 1], target[:, 0])
        drives = angle.abs() < self.aim
        arc = 2 * angle.sin() / target.norm(dim=-1).clamp_min(1e-6) * self.speed
        turn = torch.where(drives, arc, angle / self.step_time).clamp(-self.max_turn, self.max_turn)
        return torch.stack([self.speed * drives, turn], -1)

    def _target(self, human: Tensor, heading: Tensor) -> Tensor:
        """The next waypoints in the robots' frames ``[S, 2]``, in which the humans stand at ``human``."""
        waypoint = self.waypoints[torch.arange(len(self.next), device=self.next.device), self.next]
        return human + to_frame(waypoint, self.human, heading)
