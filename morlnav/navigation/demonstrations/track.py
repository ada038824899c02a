"""A recorded drive at the world's control steps: along arcs between its samples, and smoothed where these tremble."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.signal import savgol_filter
from tensordict import TensorDict
from torch import Tensor

from morlnav.navigation.demonstrations.folder import ABSENT
from morlnav.navigation.demonstrations.names import UNITS
from morlnav.navigation.demonstrations.samples import tremble
from morlnav.navigation.demonstrations.trajectory_file import COLUMNS, Trajectories
from morlnav.navigation.world import DifferentialDrive, Scene, World
from morlnav.navigation.world.geometry import wrap_angle

SMOOTHED = 1.0
"""Seconds over which poses are smoothed that jitter by more than ``JITTER``."""
SPEEDS = ("cm/s", "mm/s", "km/h")
JITTER = (0.004, 0.02)
"""Metres and radians, between a drive that bends and a sensor that trembles."""


@dataclass
class Track:
    """An episode at the world's control steps.

    Attributes:
        pose: ``[T + 1, 3]``.
        action: ``[T, 2]``.
        duration: of each step in seconds, ``[T]``.
        row: the sample of the file that each pose comes from, ``[T + 1]``.
        jitter: by how much poses trembled that were smoothed, in metres; 0 if they were not.
        scene: that it is driven in, ``[1]``.
        data: how the robot drove it, ``[T']``.
        apart: metres between the robot and the poses, ``[T']``.
        left: rows after the goal.
        seconds: that it takes in the file.
    """

    pose: Tensor
    action: Tensor
    duration: Tensor
    row: np.ndarray
    jitter: float
    scene: Scene
    data: TensorDict | None = None
    apart: Tensor | None = None
    left: int = 0
    seconds: float = 0.0


def track(file: Trajectories, number: int, world: World) -> Track:
    """An episode as the world's robot would drive it, were it to follow exactly.

    Args:
        file: of trajectories.
        number: of the episode.
        world: whose robot and step time count.

    Raises:
        ValueError: for actions that the robot cannot do, or a scene that cannot be.
    """
    rows = file.rows(number)
    samples, time = torch.from_numpy(file.samples[rows]), torch.from_numpy(file.time[rows] - file.time[rows[0]])
    jitter = 0.0
    if file.kind == "action":
        start = torch.from_numpy(file.scene["start"][number])
        action, time = samples, torch.cat([time, time[-1:] + world.step_time])
        pose = _drive(world.robot, start, action, time.diff())
        low, high = world.robot.action_low, world.robot.action_high
        wrong = ((action < low - 1e-4) | (action > high + 1e-4)).nonzero()
        if len(wrong):
            sample, entry = wrong[0].tolist()
            guess = _unit_of(action[:, entry].abs().max().item(), high[entry].item(), ("deg/s",) if entry else SPEEDS)
            guess = f"; is it in {guess}? Then: --units {COLUMNS['action'][entry]}={guess}" if guess else ""
            raise ValueError(
                f"{file.table.at(rows[sample])}, column {COLUMNS['action'][entry]}: expected {low[entry]:g} to "
                f"{high[entry]:.4g}, got {action[sample, entry]:g}{guess}"
            )
        rows = np.append(rows, rows[-1])
    else:
        time, pose, rows, jitter = _smoothed(time, samples, rows, world.step_time)
        action = world.robot.action_between(pose[:-1], pose[1:], time.diff())
    duration = time.diff()
    steady = (duration[:-1] - world.step_time).abs().max() if len(duration) > 1 else torch.zeros(())
    if steady > 1e-3 or duration[-1] > world.step_time + 1e-3:
        whole = torch.arange(0, time[-1] - 1e-6, world.step_time, dtype=time.dtype)
        before = torch.searchsorted(time, whole, right=True) - 1
        pose = torch.cat([_between(world.robot, pose, action, time, whole, before), pose[-1:]])
        rows, time = np.append(rows[before.numpy()], rows[-1]), torch.cat([whole, time[-1:]])
        duration = time.diff()
        action = world.robot.action_between(pose[:-1], pose[1:], duration)
    scene = _scene(file, number, pose[0], world)
    return Track(pose.float(), action.float(), duration.float(), rows, jitter, scene)


def _unit_of(largest: float, limit: float, units: Sequence[str]) -> str | None:
    """The unit in which an action's largest entry fits the robot best, if any of these does and ours does not."""
    factors = UNITS["speed"] | UNITS["turn"]
    fitting = [unit for unit in units if 0.01 * limit < largest * factors[unit] <= 1.01 * limit < largest]
    return max(fitting, key=factors.get, default=None)


def _between(
    robot: DifferentialDrive, pose: Tensor, action: Tensor, time: Tensor, whole: Tensor, before: Tensor
) -> Tensor:
    """Poses ``[K, 3]`` at the times ``whole``: on the arcs ``[L]``, and what an arc misses of the next pose evenly."""
    here = robot.move(pose[before], action[before], whole - time[before])
    missed = pose[1:] - robot.move(pose[:-1], action, time.diff())
    missed[:, 2] = wrap_angle(missed[:, 2])
    return here + missed[before] * ((whole - time[before]) / time.diff()[before]).unsqueeze(-1)


def _smoothed(
    time: Tensor, pose: Tensor, rows: np.ndarray, step_time: float
) -> tuple[Tensor, Tensor, np.ndarray, float]:
    """Times, poses and rows without the jitter of a sensor that is read faster than the robot steers; the jitter."""
    step = float(time.diff().median())
    if step > 0.6 * step_time or len(time) < 8:
        return time, pose, rows, 0.0
    even = np.linspace(0, float(time[-1]), round(float(time[-1]) / step) + 1)
    values = pose.numpy().copy()
    values[:, 2] = np.unwrap(values[:, 2])
    values = np.stack([np.interp(even, time.numpy(), column) for column in values.T], 1)
    *place, turn = tremble(values)
    jitter = float(np.hypot(*place) / 2**0.5)
    if jitter <= JITTER[0] and turn <= JITTER[1]:
        return time, pose, rows, 0.0
    width = min(round(SMOOTHED / step) // 2 * 2 + 1, (len(even) - 1) // 2 * 2 + 1)
    values = savgol_filter(values, max(5, width), 2, axis=0)
    nearest = np.searchsorted(time.numpy(), even, side="right") - 1
    return torch.from_numpy(even), torch.from_numpy(values), rows[nearest], max(jitter, 1e-3)


def _drive(robot: DifferentialDrive, start: Tensor, action: Tensor, duration: Tensor) -> Tensor:
    """Poses ``[T + 1, 3]`` of driving actions ``[T, 2]`` one after the other."""
    poses = [start]
    for one, time in zip(action, duration, strict=True):
        poses.append(robot.move(poses[-1], one, time))
    return torch.stack(poses)


def _scene(file: Trajectories, number: int, start: Tensor, world: World) -> Scene:
    """The scene ``[1]`` of an episode."""
    boxes = torch.from_numpy(file.scene["boxes"][number]).float()
    boxes = torch.where(boxes.isnan(), torch.tensor(ABSENT), boxes)
    goal, human = (torch.from_numpy(file.scene[name][number]).float() for name in ("goal", "human"))
    scene = Scene(start=start.float(), goal=goal, human=human, boxes=boxes, batch_size=[])
    try:
        scene.check(world.robot.radius, world.human_radius)
    except ValueError as error:
        raise ValueError(f"episode {file.names[number]}: {error}") from error
    distance = (scene.goal - scene.start[:2]).norm().item()
    if distance <= world.goal_radius:
        raise ValueError(
            f"{file.table.at(file.rows(number)[0])}: episode {file.names[number]} begins {distance:.2f} m from its "
            f"goal, where it has arrived already; expected more than {world.goal_radius:g} m"
        )
    return scene.unsqueeze(0).to(world.device)
