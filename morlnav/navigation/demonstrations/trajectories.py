"""Trajectories of other origin as demonstrations, and demonstrations as trajectories."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from morlnav.navigation.demonstrations.record import OpenLoop, roll_out, successes
from morlnav.navigation.demonstrations.trajectory_file import (
    BOX,
    COLUMNS,
    SCENE_COLUMNS,
    Trajectories,
    read_trajectories,
)
from morlnav.navigation.envs import NavigationEnv, Objective
from morlnav.navigation.world import DifferentialDrive, Scene, TensorWorld, World
from morlnav.navigation.world.geometry import wrap_angle

ABSENT = (1000.0, 1000.0, 0.1, 0.1, 0.0)
"""A box that is out of everyone's way, where a scene has fewer boxes than others of its file."""


@torch.no_grad()
def import_demonstrations(
    path: str | Path,
    *,
    world: World | None = None,
    objectives: Mapping[str, Objective] | None = None,
    tolerance: float = 0.1,
) -> TensorDict:
    """Read trajectories from a CSV or NPZ file and drive them again, as demonstrations of the robot (Sec. III-C).

    The file holds poses, or actions and where the robot starts, with goal, human and boxes of every episode; its schema
    is in ``docs/demonstrations.md``. At every control step the robot takes the arc from where it is to the next pose
    (:meth:`~morlnav.navigation.world.DifferentialDrive.action_between`). Between two samples it is taken to drive an
    arc, so that other sampling rates than the world's do. Actions are driven as they are. An episode ends where it
    reaches the goal.

    Args:
        path: ends with ``.csv`` or ``.npz``.
        world: the engine; tensors by default.
        objectives: reward terms by name as for :class:`~morlnav.navigation.envs.NavigationEnv`.
        tolerance: how far from a pose of the file the robot may get, in metres.

    Returns:
        ``[N]`` as from :func:`~morlnav.navigation.demonstrations.record_demonstrations`; ``action`` and
        ``executed_action`` are the same.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming file, row and column, if the file does not follow the schema, the robot cannot drive as it
            says, or an episode meets an obstacle or misses its goal.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "straight.csv"
        >>> rows = ["x,y,heading,goal_x,goal_y,human_x,human_y", *(f"{0.1 * i},0,0,2,0,1,1" for i in range(19))]
        >>> _ = file.write_text(chr(10).join(rows))
        >>> data = import_demonstrations(file)
        >>> data["action"][0], bool(data["next", "outcome", "goal"][-1])
        (tensor([0.5000, 0.0000]), True)
    """
    world = world if world is not None else TensorWorld()
    file = read_trajectories(path)
    samples = [np.flatnonzero(file.episode == number) for number in range(file.episode.max() + 1)]
    tracks = [_track(file, rows, number, world) for number, rows in enumerate(samples)]
    scene = _scene(file, torch.stack([track["pose"][0] for track in tracks]), world)
    env = NavigationEnv(world, lambda *_, **__: scene, objectives, num_envs=len(tracks), seed=0)
    padded = {name: pad_sequence([track[name] for track in tracks], batch_first=True) for name in ("action", "pose")}
    if file.kind == "pose":
        for i, track in enumerate(tracks):
            padded["pose"][i, len(track["pose"]) :] = track["pose"][-1]
        driver = _Follow(env.world, padded["pose"], pad_sequence([track["duration"] for track in tracks], True))
    else:
        driver = OpenLoop(padded["action"])
    steps = padded["action"].shape[1]
    episodes = roll_out(driver, env, scene, None, steps)
    driven, reached = successes(episodes)
    for number, track in enumerate(tracks):
        _check_episode(
            file, number, episodes[number], driven[number], bool(reached[number]), track, tolerance, world.goal_radius
        )
    episodes["episode"] = torch.arange(len(tracks)).unsqueeze(1).expand(driven.shape).clone()
    return episodes[driven]


class _Follow:
    """Takes the arc from where the robots are to their next poses ``[B, T + 1, 3]``, in the time ``[B, T]`` for it."""

    def __init__(self, world: World, pose: Tensor, duration: Tensor) -> None:
        self.world, self.pose, self.step = world, pose, 0
        self.duration = torch.where(duration > 0, duration, world.step_time)

    def __call__(self, observation: Tensor) -> Tensor:
        now, robot = self.world.pose.cpu(), self.world.robot
        target, duration = self.pose[:, self.step + 1], self.duration[:, self.step]
        self.step += 1
        action = robot.action_between(now, target, duration)
        return robot.limit(action).to(observation)


def _track(file: Trajectories, rows: np.ndarray, number: int, world: World) -> dict[str, Tensor]:
    """One episode at the world's control steps: ``pose`` ``[T + 1, 3]``, ``action`` ``[T, 2]``, ``duration`` ``[T]``,
    and the sample of the file that each pose comes from, ``[T + 1]``."""
    samples, time = torch.from_numpy(file.samples[rows]), torch.from_numpy(file.time[rows] - file.time[rows[0]])
    if file.kind == "action":
        start = torch.from_numpy(file.scene["start"][number])
        action, time = samples, torch.cat([time, time[-1:] + world.step_time])
        pose = _drive(world.robot, start, action, time.diff())
        low, high = world.robot.action_low, world.robot.action_high
        wrong = ((action < low - 1e-4) | (action > high + 1e-4)).nonzero()
        if len(wrong):
            sample, entry = wrong[0].tolist()
            raise ValueError(
                f"{file.row(rows[sample])}, column {COLUMNS['action'][entry]}: expected {low[entry]:g} to "
                f"{high[entry]:.4g}, got {action[sample, entry]:g}."
            )
        rows = np.append(rows, rows[-1])
    else:
        pose = samples
        action = world.robot.action_between(pose[:-1], pose[1:], time.diff())
    duration = time.diff()
    steady = (duration[:-1] - world.step_time).abs().max() if len(duration) > 1 else torch.zeros(())
    if steady > 1e-3 or duration[-1] > world.step_time + 1e-3:
        whole = torch.arange(0, time[-1] - 1e-6, world.step_time, dtype=time.dtype)
        before = torch.searchsorted(time, whole, right=True) - 1
        pose = torch.cat([world.robot.move(pose[before], action[before], whole - time[before]), pose[-1:]])
        rows, time = np.append(rows[before.numpy()], rows[-1]), torch.cat([whole, time[-1:]])
        duration = time.diff()
        action = world.robot.action_between(pose[:-1], pose[1:], duration)
    return {"pose": pose.float(), "action": action.float(), "duration": duration.float(), "row": torch.from_numpy(rows)}


def _drive(robot: DifferentialDrive, start: Tensor, action: Tensor, duration: Tensor) -> Tensor:
    """Poses ``[T + 1, 3]`` of driving actions ``[T, 2]`` one after the other."""
    poses = [start]
    for one, time in zip(action, duration, strict=True):
        poses.append(robot.move(poses[-1], one, time))
    return torch.stack(poses)


def _scene(file: Trajectories, start: Tensor, world: World) -> Scene:
    boxes = torch.from_numpy(file.scene["boxes"]).float()
    boxes = torch.where(boxes.isnan(), torch.tensor(ABSENT), boxes)
    parts = {name: torch.from_numpy(file.scene[name]).float() for name in ("goal", "human")}
    scene = Scene(start=start, boxes=boxes, **parts, batch_size=[len(start)])
    for number in range(len(scene)):
        try:
            scene[number].check(world.robot.radius, world.human_radius)
        except ValueError as error:
            raise ValueError(f"{file.path}, episode {number}: {error}") from error
    return scene.to(world.device)


def _check_episode(
    file: Trajectories,
    number: int,
    episode: TensorDict,
    driven: Tensor,
    reached: bool,
    track: Mapping[str, Tensor],
    tolerance: float,
    radius: float,
) -> None:
    """Refuse an episode ``[T]`` that strays from its poses, meets an obstacle or does not arrive."""
    steps = min(int(driven.sum()), len(track["action"]))
    apart = (episode["next", "pose"][:steps, :2] - track["pose"][1 : steps + 1, :2]).norm(dim=-1)
    turned = wrap_angle(episode["next", "pose"][:steps, 2] - track["pose"][1 : steps + 1, 2]).abs()
    apart[-1] = turned[-1] = 0  # where the goal's disc or an obstacle stops the robot
    strays = ((apart > tolerance) | (turned > 2 * tolerance)).nonzero()
    if len(strays) and file.kind == "pose":
        step = int(strays[0])
        raise ValueError(
            f"{file.row(int(track['row'][step + 1]))}: the robot cannot follow, it would be {apart[step]:.2f} m and "
            f"{turned[step]:.2f} rad off; expected a drive forward within its speeds."
        )
    last = episode[steps - 1]
    met = [name for name in ("human", "box") if last["next", "outcome", name]]
    if met:
        where = file.row(int(track["row"][steps]))
        raise ValueError(f"{where}: episode {number} touches {'the human' if met == ['human'] else 'a box'} here.")
    if not reached or int(driven.sum()) > len(track["action"]):
        distance = (last["next", "pose"][:2] - last["scene", "goal"]).norm().item()
        raise ValueError(
            f"{file.row(int(track['row'][-1]))}: episode {number} ends {distance:.2f} m from its goal, expected "
            f"at most {radius:g} m."
        )


def export_demonstrations(data: TensorDict, path: str | Path, kind: str = "pose", world: World | None = None) -> None:
    """Write demonstrations into a file that :func:`import_demonstrations` reads, as they were driven.

    Args:
        data: ``[N]``, as from :func:`~morlnav.navigation.demonstrations.record_demonstrations`.
        path: ends with ``.csv`` or ``.npz``; a file that is there is replaced.
        kind: ``"pose"`` or ``"action"``; of actions the executed ones.
        world: that they were driven in; tensors by default.

    Raises:
        ValueError: for another kind of file or of content.

    Examples:
        >>> import tempfile
        >>> from morlnav.navigation.demonstrations.record import record_demonstrations
        >>> from morlnav.navigation.modules import CircumnavigationOracle
        >>> from morlnav.navigation.world import SceneSampler
        >>> data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 2)
        >>> file = Path(tempfile.mkdtemp()) / "demonstrations.npz"
        >>> export_demonstrations(data, file)
        >>> torch.allclose(import_demonstrations(file)["action"], data["action"], atol=1e-3)
        True
    """
    path, world = Path(path), world or TensorWorld()
    if kind not in COLUMNS or path.suffix.lower() not in (".csv", ".npz"):
        raise ValueError(f"Trajectories are 'pose' or 'action' in .csv or .npz files, got {kind!r} in {path}.")
    first = data["step"] == 0
    time = data["step"].double() * world.step_time
    samples, episode = data["executed_action"], data["episode"]
    if kind == "pose":
        last = torch.cat([first[1:], torch.tensor([True])])
        ends = time[last] + _last_duration(data[last], world)
        order = torch.argsort(torch.cat([episode, episode[last]]), stable=True)
        samples = torch.cat([data["pose"], data["next", "pose"][last]])[order]
        time, episode = torch.cat([time, ends])[order], torch.cat([episode, episode[last]])[order]
    scene = {name: data["scene", name][first].double() for name in ("goal", "human", "boxes")}
    if kind == "action":
        scene["start"] = data["scene", "start"][first].double()
    arrays = {"episode": episode, "time": time, kind: samples.double()} | scene
    arrays = {name: value.numpy() for name, value in arrays.items()}
    if path.suffix.lower() == ".npz":
        np.savez_compressed(path, **arrays)
        return
    _, which = np.unique(arrays["episode"], return_inverse=True)
    columns = {"episode": arrays["episode"], "time": arrays["time"].round(6)}
    columns |= dict(zip(COLUMNS[kind], arrays[kind].T, strict=True))
    for name, parts in SCENE_COLUMNS.items():
        if name in scene:
            columns |= dict(zip(parts, arrays[name][which].T, strict=True))
    for i in range(arrays["boxes"].shape[1]):
        columns |= {f"box{i + 1}_{part}": arrays["boxes"][which, i, j] for j, part in enumerate(BOX)}
    pd.DataFrame(columns).to_csv(path, index=False)


def _last_duration(last: TensorDict, world: World) -> Tensor:
    """How long the last steps ``[E]`` of episodes took, which end at the goal's disc, in seconds ``[E]``."""
    times = torch.arange(1, world.substeps + 1) * (world.step_time / world.substeps)
    reached = world.robot.move(last["pose"].unsqueeze(1), last["executed_action"].unsqueeze(1), times)
    return times[(reached - last["next", "pose"].unsqueeze(1)).abs().sum(-1).argmin(-1)].double()
