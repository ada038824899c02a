"""Trajectories of other origin as demonstrations: the robot drives them again."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from morlnav.navigation.demonstrations.columns import Reading
from morlnav.navigation.demonstrations.folder import join_demonstrations
from morlnav.navigation.demonstrations.record import OpenLoop, roll_out, successes
from morlnav.navigation.demonstrations.repeats import repeats
from morlnav.navigation.demonstrations.track import Track, track
from morlnav.navigation.demonstrations.trajectory_file import Trajectories, read_trajectories
from morlnav.navigation.envs import NavigationEnv, Objective
from morlnav.navigation.world import TensorWorld, World
from morlnav.navigation.world.geometry import to_frame, wrap_angle

LOOK_AHEAD = 0.4
"""Metres ahead at which the robot aims for the path that it is beside of."""
FEWEST_STEPS = 5
MOST_REASONS = 10
"""Of more bad episodes the rest is named without a reason."""


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

    A file holds poses, or actions and where the robot starts, with goal, human and boxes of every episode
    (``docs/own-demonstrations.md``). At every control step the robot takes the arc from where it is to the next pose
    (:meth:`~morlnav.navigation.world.DifferentialDrive.action_between`), and steers toward the path where it has got
    beside it. Between two samples it is taken to drive an arc, so that other sampling rates than the world's
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
    if tolerance is not None and not 0 < tolerance < np.inf:
        raise ValueError(f"tolerance must be positive, got {tolerance}.")
    paths = [Path(each) for each in ([path] if isinstance(path, str | Path) else path)]
    parts: list[tuple[Path, TensorDict]] = []
    for i, each in enumerate(paths):
        if os.path.realpath(each) in map(os.path.realpath, paths[:i]):
            raise ValueError(f"{each} is named twice.")
        file = read_trajectories(each, reading, getattr(world.robot, "max_speed", np.inf))
        if file.kind == "action" and tolerance is not None:
            raise ValueError(f"{each} holds actions, which are driven as they are; leave the tolerance out.")
        drives = _drive_again(file, world, objectives, 0.2 if tolerance is None else tolerance)
        drives = _without_repeats(file, drives, parts)
        _refuse(file, good_only)
        parts += [(each, drive.data) for drive in drives]
        tell(_told(file, drives, world))
    return join_demonstrations([data for _, data in parts])


def _drive_again(
    file: Trajectories, world: World, objectives: Mapping[str, Objective] | None, tolerance: float
) -> list[Track]:
    """The episodes that can be driven; what is wrong with the others is noted in the file."""
    tracks: dict[int, Track] = {}
    for number in [number for number in range(len(file.names)) if number not in file.problems]:
        with file.concerning(number):
            tracks[number] = track(file, number, world)
    if not tracks:
        return []
    scene = torch.cat([each.scene for each in tracks.values()])
    env = NavigationEnv(world, lambda *_, **__: scene, objectives, num_envs=len(tracks), seed=0)
    action, duration = (
        pad_sequence([getattr(each, name) for each in tracks.values()], batch_first=True)
        for name in ("action", "duration")
    )
    driver: Callable[[Tensor], Tensor] = OpenLoop(action)
    if file.kind == "pose":
        last = action.shape[1]
        steps = torch.arange(last + 1)
        pose = torch.stack([each.pose[steps.clamp(max=len(each.pose) - 1)] for each in tracks.values()])
        driver = _Follow(env.world, pose, duration)
    episodes = roll_out(driver, env, scene, None, action.shape[1])
    driven, reached = successes(episodes)
    drives = []
    for i, (number, each) in enumerate(tracks.items()):
        with file.concerning(number):
            drives.append(_checked(file, number, episodes[i, driven[i]], bool(reached[i]), each, tolerance, world))
    return drives


def _without_repeats(file: Trajectories, drives: list[Track], before: list[tuple[Path, TensorDict]]) -> list[Track]:
    """The drives that no earlier file holds; the others are noted in this one."""
    new = [drive.data for drive in drives]
    if same := len(repeats(new)) if new else 0:
        file.notes.append(f"{same} episode{'s drive' if same > 1 else ' drives'} as others of them do")
    again = repeats([*(data for _, data in before), join_demonstrations(new)]) if before and new else {}
    for later, earlier in again.items():
        number = int(new[later - len(before)]["episode"][0])
        where = f"episode {file.names[number]} is one of {before[earlier][0]} again, the same drive and scene"
        file.problems.setdefault(number, where)
    return [drive for i, drive in enumerate(drives) if i + len(before) not in again]


def _refuse(file: Trajectories, good_only: bool) -> None:
    """One sentence that names all bad episodes, or a note of those that are left out."""
    bad = [(file.names[number], file.problems[number].rstrip(".")) for number in sorted(file.problems)]
    if not bad:
        return
    good = len(file.names) - len(bad)
    if len(file.names) == 1:
        raise ValueError(_ended(f"{file.path}, {bad[0][1]}"))
    listed = "; ".join(f"episode {name}: {problem}" for name, problem in bad[:MOST_REASONS])
    if len(bad) > MOST_REASONS:
        listed += f"; and episodes {', '.join(name for name, _ in bad[MOST_REASONS:])}"
    if good_only and good:
        file.notes.append(f"{len(bad)} of {len(file.names)} episodes left out ({listed})")
        return
    advice = f"; --good-only takes the other {good}" if good else ""
    raise ValueError(_ended(f"{file.path}: {len(bad)} of {len(file.names)} episodes cannot be taken: {listed}{advice}"))


def _ended(sentence: str) -> str:
    return sentence if sentence.endswith("?") else f"{sentence}."


def _told(file: Trajectories, drives: Sequence[Track], world: World) -> str:
    """What was read, in a line."""
    steps = np.concatenate([np.diff(file.time[file.rows(number)]) for number in range(len(file.names))])
    rate = f" at {1 / np.median(steps):.3g} Hz" if len(steps) else ""
    speed = torch.cat([drive.data["action"][:, 0] for drive in drives])
    apart = torch.cat([drive.apart for drive in drives])
    left, jitter = sum(drive.left for drive in drives), max(drive.jitter for drive in drives)
    still = [(drive.data["action"].abs() < torch.tensor([0.02, 0.05])).all(-1).long().cumprod(0) for drive in drives]
    waits = world.step_time * max(int(steps.sum()) for steps in still)
    facts = [
        f"{len(file.time)} rows, {len(drives)} episode{'s' * (len(drives) > 1)} of "
        f"{sum(drive.seconds for drive in drives):.1f} s{rate}, {speed.mean():.2f} m/s on average and "
        f"{speed.max():.2f} at most",
        f"followed within {apart.max():.2f} m ({apart.mean():.3f} on average)" * (file.kind == "pose"),
        f"{left} row{'s' * (left > 1)} after the goal left out" * bool(left),
        f"the robot stands for up to {waits:.1f} s before it moves, which is learned, too" * (waits > 2),
        f"poses jitter by {1000 * jitter:.0f} mm and are smoothed" * (jitter > 0),
        *file.notes,
        f"read {', '.join(file.used)}",
        f"ignored {', '.join(file.ignored) or 'nothing'}",
    ]
    return f"{file.path}: {'; '.join(fact for fact in facts if fact)}."


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


def _checked(
    file: Trajectories, number: int, episode: TensorDict, reached: bool, track: Track, tolerance: float, world: World
) -> Track:
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
    if file.kind == "pose":
        _check_between(file, rows, episode, track, tolerance)
    left = int((rows > track.row[steps]).sum())
    episode["episode"] = torch.full_like(episode["episode"], number)
    seconds = float(file.time[rows[-1]] - file.time[rows[0]])
    return replace(track, data=episode, apart=apart[:-1] if steps > 1 else apart, left=left, seconds=seconds)


def _check_between(file: Trajectories, rows: np.ndarray, episode: TensorDict, track: Track, tolerance: float) -> None:
    """Refuse samples between control steps that lie off the drive, as where a localisation jumps there and back."""
    time = np.append(0, track.duration.double().cumsum(0))[: len(episode)]
    rows = rows[file.time[rows] - file.time[rows[0]] <= time[-1]]
    driven = episode["pose"][:, :2].double().numpy()
    at = file.time[rows] - file.time[rows[0]]
    place = np.stack([np.interp(at, time, column) for column in driven.T], 1)
    off = np.linalg.norm(file.samples[rows, :2] - place, axis=1)
    if len(off) and off.max() > tolerance + 5 * track.jitter:
        row = rows[off.argmax()]
        raise ValueError(
            f"{file.table.at(row)}: the pose lies {off.max():.2f} m off the drive before and after it; does the "
            f"localisation jump here? Then leave the row out, or allow it with --tolerance"
        )


def _why(track: Track, step: int, world: World) -> str:
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
