"""Trajectories of other origin as demonstrations, and demonstrations as trajectories."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from scipy.signal import savgol_filter
from tensordict import TensorDict
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from morlnav.navigation.demonstrations.columns import Reading
from morlnav.navigation.demonstrations.folder import ABSENT, join_demonstrations
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
from morlnav.navigation.world.geometry import to_frame, wrap_angle

LOOK_AHEAD = 0.4
"""Metres ahead at which the robot aims for the path that it is beside of."""
SMOOTHED = 1.0
"""Seconds over which poses are smoothed that jitter by more than ``JITTER``."""
JITTER = (0.004, 0.02)
"""Metres and radians, between a drive that bends and a sensor that trembles."""
FEWEST_STEPS = 5


@torch.no_grad()
def import_demonstrations(
    path: str | Path | Sequence[str | Path],
    *,
    reading: Reading | None = None,
    world: World | None = None,
    objectives: Mapping[str, Objective] | None = None,
    tolerance: float | None = None,
    good_only: bool = False,
    tell: Callable[[str], None] = print,
) -> TensorDict:
    """Read trajectories from files and drive them again, as demonstrations of the robot (Sec. III-C).

    A file holds poses, or actions and where the robot starts, with goal, human and boxes of every episode; what is
    understood is in ``docs/demonstrations.md``. At every control step the robot takes the arc from where it is to the
    next pose (:meth:`~morlnav.navigation.world.DifferentialDrive.action_between`), and steers toward the path where it
    has got beside it. Between two samples it is taken to drive an arc, so that other sampling rates than the world's
    do; poses that jitter are smoothed. Actions are driven as they are. An episode ends where it reaches the goal.

    Args:
        path: of a file, or of several.
        reading: what is known beforehand about columns, units and all else.
        world: the engine; tensors by default.
        objectives: reward terms by name as for :class:`~morlnav.navigation.envs.NavigationEnv`.
        tolerance: how far from a pose of the file the robot may get, in metres (0.2 by default);
            twice as many radians in heading.
        good_only: leave out the episodes that cannot be taken, instead of refusing them all.
        tell: called with a line for each file, which says what was read, assumed and left out.

    Returns:
        ``[N]`` as from :func:`~morlnav.navigation.demonstrations.record_demonstrations`; ``action`` and
        ``executed_action`` are the same.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming file, row and column, if the file does not follow the schema or cannot be meant so; and
            naming every episode that the robot cannot drive as the file says, or that meets an obstacle or misses its
            goal.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "straight.csv"
        >>> rows = ["t,x,y,goal_x,goal_y,human_x,human_y", *(f"{0.2 * i},{0.1 * i},0,2,0,1,1" for i in range(18))]
        >>> _ = file.write_text(chr(10).join(rows))
        >>> data = import_demonstrations(file, tell=lambda line: print(line.replace("; ", chr(10)).partition(": ")[2]))
        18 rows, 1 episode of 3.4 s at 5 Hz, 0.50 m/s on average and 0.50 at most
        followed within 0.00 m (0.000 on average)
        headings are those of the motion, for no column tells them
        read t, x, y, goal_x, goal_y, human_x, human_y
        ignored nothing.
        >>> data["action"][0], bool(data["next", "outcome", "goal"][-1])
        (tensor([0.5000, 0.0000]), True)
    """
    world = world if world is not None else TensorWorld()
    paths = [path] if isinstance(path, str | Path) else list(path)
    parts = []
    for each in paths:
        file = read_trajectories(each, reading, getattr(world.robot, "max_speed", np.inf))
        if file.kind == "action" and tolerance is not None:
            raise ValueError(f"{each} holds actions, which are driven as they are; leave the tolerance out.")
        drives = _drive_again(file, world, objectives, 0.2 if tolerance is None else tolerance)
        _refuse(file, good_only)
        parts.append(join_demonstrations([drive.data for drive in drives]))
        tell(_told(file, drives))
    return parts[0] if len(parts) == 1 else join_demonstrations(parts)


@dataclass
class _Drive:
    """An episode that the robot drove as the file says."""

    data: TensorDict  # [T]
    apart: Tensor  # m, from the poses of the file, [T]
    left: int  # rows after the goal
    jitter: float  # m, of poses that were smoothed
    seconds: float  # in the file


def _drive_again(
    file: Trajectories, world: World, objectives: Mapping[str, Objective] | None, tolerance: float
) -> list[_Drive]:
    """The episodes that can be driven; what is wrong with the others is noted in the file."""
    tracks: dict[int, _Track] = {}
    for number in range(len(file.names)):
        if number not in file.problems:
            with file.concerning(number):
                tracks[number] = _track(file, number, world)
    if not tracks:
        return []
    scene = torch.cat([track.scene for track in tracks.values()])
    env = NavigationEnv(world, lambda *_, **__: scene, objectives, num_envs=len(tracks), seed=0)
    pose, action, duration = (
        pad_sequence([getattr(track, name) for track in tracks.values()], batch_first=True)
        for name in ("pose", "action", "duration")
    )
    driver: Callable[[Tensor], Tensor] = OpenLoop(action)
    if file.kind == "pose":
        for i, track in enumerate(tracks.values()):
            pose[i, len(track.pose) :] = track.pose[-1]
        driver = _Follow(env.world, pose, duration)
    episodes = roll_out(driver, env, scene, None, action.shape[1])
    driven, reached = successes(episodes)
    drives = []
    for i, (number, track) in enumerate(tracks.items()):
        with file.concerning(number):
            part = episodes[i, driven[i]]
            drives.append(_checked(file, number, part, bool(reached[i]), track, tolerance, world))
    return drives


def _refuse(file: Trajectories, good_only: bool) -> None:
    """One sentence that names all bad episodes, or a note of those that are left out."""
    bad = [file.problems[number] for number in sorted(file.problems)]
    if not bad:
        return
    good = len(file.names) - len(bad)
    if len(file.names) == 1:
        raise ValueError(f"{file.path}, {bad[0].rstrip('.')}.")
    listed = "; ".join(
        f"episode {file.names[number]}: {file.problems[number].rstrip('.')}" for number in sorted(file.problems)
    )
    if good_only and good:
        file.notes.append(f"{len(bad)} of {len(file.names)} episodes left out ({listed})")
        return
    advice = f"; --good-only takes the other {good}" if good else ""
    raise ValueError(f"{file.path}: {len(bad)} of {len(file.names)} episodes cannot be taken: {listed}{advice}.")


def _told(file: Trajectories, drives: Sequence[_Drive]) -> str:
    """What was read, in a line."""
    steps = np.concatenate([np.diff(file.time[file.rows(number)]) for number in range(len(file.names))])
    rate = f" at {1 / np.median(steps):.3g} Hz" if len(steps) else ""
    speed = torch.cat([drive.data["action"][:, 0] for drive in drives])
    apart = torch.cat([drive.apart for drive in drives])
    left, jitter = sum(drive.left for drive in drives), max(drive.jitter for drive in drives)
    facts = [
        f"{len(file.time)} rows, {len(drives)} episode{'s' * (len(drives) > 1)} of "
        f"{sum(drive.seconds for drive in drives):.1f} s{rate}, {speed.mean():.2f} m/s on average and "
        f"{speed.max():.2f} at most",
        f"followed within {apart.max():.2f} m ({apart.mean():.3f} on average)" * (file.kind == "pose"),
        f"{left} row{'s' * (left > 1)} after the goal left out" * bool(left),
        f"poses jitter by {1000 * jitter:.0f} mm and are smoothed" * (jitter > 0),
        *file.notes,
        f"read {', '.join(file.used)}",
        f"ignored {', '.join(file.ignored) or 'nothing'}",
    ]
    return f"{file.path}: {'; '.join(fact for fact in facts if fact)}."


@dataclass
class _Track:
    """An episode at the world's control steps.

    Attributes:
        pose: ``[T + 1, 3]``.
        action: ``[T, 2]``.
        duration: of each step in seconds, ``[T]``.
        row: the sample of the file that each pose comes from, ``[T + 1]``.
        jitter: by how much poses trembled that were smoothed, in metres; 0 if they were not.
        scene: that it is driven in, ``[1]``.
    """

    pose: Tensor
    action: Tensor
    duration: Tensor
    row: np.ndarray
    jitter: float
    scene: Scene


def _track(file: Trajectories, number: int, world: World) -> _Track:
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
            raise ValueError(
                f"{file.table.at(rows[sample])}, column {COLUMNS['action'][entry]}: expected {low[entry]:g} to "
                f"{high[entry]:.4g}, got {action[sample, entry]:g}"
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
    return _Track(pose.float(), action.float(), duration.float(), rows, jitter, scene)


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
    """Times ``[L]`` and poses ``[L, 3]`` without the jitter of a sensor that is read faster than the robot is steered.

    What trembles shows in third differences, where a drive that bends does not.
    """
    step = float(time.diff().median())
    if step > 0.6 * step_time or len(time) < 8:
        return time, pose, rows, 0.0
    even = np.linspace(0, float(time[-1]), round(float(time[-1]) / step) + 1)
    values = pose.numpy().copy()
    values[:, 2] = np.unwrap(values[:, 2])
    values = np.stack([np.interp(even, time.numpy(), column) for column in values.T], 1)
    tremble = np.median(np.abs(np.diff(values, 3, axis=0)), axis=0) / (0.6745 * 20**0.5)
    jitter = float(np.hypot(*tremble[:2]) / 2**0.5)
    if jitter <= JITTER[0] and tremble[2] <= JITTER[1]:
        return time, pose, rows, 0.0
    width = min(round(SMOOTHED / step) // 2 * 2 + 1, (len(even) - 1) // 2 * 2 + 1)
    values = savgol_filter(values, max(5, width), 2, axis=0)
    nearest = np.searchsorted(time.numpy(), even, side="right") - 1
    return torch.from_numpy(even), torch.from_numpy(values), rows[nearest], max(jitter, 1e-3)


class _Follow:
    """Takes the arc from where the robots are to their next poses ``[B, T + 1, 3]``, in the time ``[B, T]`` for it.

    What an arc leaves to the side is steered for, at a point :data:`LOOK_AHEAD` metres ahead, while the robot moves.
    """

    def __init__(self, world: World, pose: Tensor, duration: Tensor) -> None:
        self.world, self.pose, self.step = world, pose, 0
        self.duration = torch.where(duration > 0, duration, world.step_time)

    def __call__(self, observation: Tensor) -> Tensor:
        now, robot = self.world.pose.cpu(), self.world.robot
        target, duration = self.pose[:, self.step + 1], self.duration[:, self.step]
        self.step += 1
        action = robot.action_between(now, target, duration)
        left = to_frame(target[:, :2], robot.move(now, action, duration)[:, :2], target[:, 2])[:, 1]
        moving = (action[:, 0] / 0.1).clamp(0, 1)
        action[:, 1] += moving * torch.atan2(left, torch.full_like(left, LOOK_AHEAD)) / self.world.step_time
        return robot.limit(action).to(observation)


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


def _checked(
    file: Trajectories, number: int, episode: TensorDict, reached: bool, track: _Track, tolerance: float, world: World
) -> _Drive:
    """An episode ``[T']`` as it was driven; refused if it strays from its poses, meets anything or does not arrive."""
    steps, name, last = min(len(episode), len(track.action)), file.names[number], episode[len(episode) - 1]
    difference = episode["next", "pose"][:steps] - track.pose[1 : steps + 1]
    apart, turned = difference[:, :2].norm(dim=-1), wrap_angle(difference[:, 2]).abs()
    apart[-1] = turned[-1] = 0  # where the goal's disc or an obstacle stops the robot
    strays = ((apart > tolerance) | (turned > 2 * tolerance)).nonzero()
    if len(strays) and file.kind == "pose":
        step = int(strays[0])
        raise ValueError(
            f"{file.table.at(track.row[step + 1])}: the robot cannot follow, it would be {apart[step]:.2f} m and "
            f"{turned[step]:.2f} rad off; expected a drive forward within its speeds{_why(track, step, world)}"
        )
    met = [thing for thing in ("human", "box") if last["next", "outcome", thing]]
    if met:
        where = file.table.at(track.row[steps])
        raise ValueError(f"{where}: episode {name} touches {'the human' if met == ['human'] else 'a box'} here")
    if not reached or len(episode) > len(track.action):
        distance = (last["next", "pose"][:2] - last["scene", "goal"]).norm().item()
        raise ValueError(
            f"{file.table.at(track.row[-1])}: episode {name} ends {distance:.2f} m from its goal, expected at most "
            f"{world.goal_radius:g} m"
        )
    if steps < FEWEST_STEPS:
        raise ValueError(
            f"{file.table.at(track.row[0])}: episode {name} takes {steps} control steps, which show nothing; expected "
            f"{FEWEST_STEPS} or more"
        )
    after = (track.pose[steps:, :2] - last["scene", "goal"]).norm(dim=-1)
    whole = (last["scene", "goal"] - track.pose[0, :2]).norm().item()
    if file.kind == "pose" and after.max() > max(1.5, whole / 2):
        raise ValueError(
            f"{file.table.at(track.row[steps])}: episode {name} reaches its goal here and then drives on, up to "
            f"{after.max():.1f} m from it; do other drives follow? Then number them in a column episode"
        )
    rows = file.rows(number)
    left = int((rows > track.row[steps]).sum())
    episode["episode"] = torch.full_like(episode["episode"], number)
    seconds = float(file.time[rows[-1]] - file.time[rows[0]])
    return _Drive(episode, apart[:-1] if steps > 1 else apart, left, track.jitter, seconds)


def _why(track: _Track, step: int, world: World) -> str:
    """What may have kept the robot from following, of the steps before it strayed."""
    wanted = track.action[max(0, step - 4) : step + 1]
    limit = world.robot.action_high
    if wanted[:, 0].max() > 1.02 * limit[0]:
        return f", not {wanted[:, 0].max():.2f} m/s of at most {limit[0]:g}"
    if wanted[:, 0].min() < -0.02:
        return f", not backwards at {-wanted[:, 0].min():.2f} m/s"
    if wanted[:, 1].abs().max() > limit[1]:
        return f", not a turn of {wanted[:, 1].abs().max():.2f} rad/s"
    return ", and not sideways"


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
        >>> torch.allclose(import_demonstrations(file, tell=str)["action"], data["action"], atol=1e-3)
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
