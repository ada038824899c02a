"""Demonstrations that were recorded elsewhere, as they are or replayed among other boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from tensordict import TensorDict
from torch.nn.utils.rnn import pad_sequence

from morlnav.limits import check_at_least
from morlnav.navigation.demonstrations.folder import (
    ABSENT,
    check_drives,
    check_world,
    demonstrations_digest,
    join_demonstrations,
    load_demonstrations,
)
from morlnav.navigation.demonstrations.record import OpenLoop, hide_human, keep_successes, roll_out
from morlnav.navigation.demonstrations.repeats import repeats
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.world import Scene, TensorWorld, World
from morlnav.navigation.world.geometry import distance_to_box, to_frame


def recorded_demonstrations(
    path: str | Path | Sequence[str | Path],
    sampler: Callable[..., Scene] | None = None,
    num: int | None = None,
    *,
    world: World | None = None,
    digest: str | None = None,
    observe_human: bool = True,
    seed: int = 0,
    num_envs: int = 256,
) -> tuple[TensorDict, int]:
    """Demonstrations from a folder, in the place of :func:`record_demonstrations` in a pipeline.

    Args:
        path: of a folder that :func:`save_demonstrations` wrote, as ``morlnav-record`` does, or of several, whose
            scenes may hold different numbers of boxes.
        sampler: of scenes whose boxes the demonstrations are replayed among; not needed without ``num``.
        num: demonstrations to make by :func:`replay_demonstrations`; ``None`` takes them as they are.
        world: that they are trained or replayed in, which must be that of the recording.
        digest: what :func:`demonstrations_digest` said of the folder; ``None`` takes any content.
        observe_human: whether the observations keep the human's position (``-NH`` ablation).
        seed: of the replays.
        num_envs: replays side by side.

    Returns:
        The transitions ``[N]`` and the number of episodes tried for them.

    Raises:
        FileNotFoundError: if the folder holds no demonstrations.
        ValueError: if they are damaged, others than those of ``digest``, of another world, or can hardly be replayed.
    """
    world = world or TensorWorld()
    if digest is not None and digest != demonstrations_digest(path):
        raise ValueError(f"The demonstrations in {path} have changed since this run was configured.")
    parts = [_of_this_world(one, world) for one in ([path] if isinstance(path, str | Path) else path)]
    data = join_demonstrations(parts) if len(parts) > 1 else parts[0]
    if again := repeats(parts):
        raise ValueError(f"{', '.join(map(str, path))} hold {len(again)} drives twice; name each folder once.")
    tries = int(data["episode"].unique().numel())
    if num is not None:
        data, tries = replay_demonstrations(data, sampler, num, world=world, seed=seed, num_envs=num_envs)
    return (data if observe_human else hide_human(data)), tries


def _of_this_world(path: str | Path, world: World) -> TensorDict:
    """A folder's demonstrations ``[N]``, which the world's robot can have driven."""
    check_world(path, world)
    data = load_demonstrations(path)
    check_drives(data, f"the demonstrations in {path}", world)
    return data


@torch.no_grad()
def replay_demonstrations(
    data: TensorDict,
    sampler: Callable[..., Scene],
    num: int,
    *,
    world: World | None = None,
    seed: int = 0,
    num_envs: int = 256,
) -> tuple[TensorDict, int]:
    """Drive demonstrations again among random boxes: one pattern, ``N_D`` layouts (Sec. III-C).

    Start, goal and human stay; the boxes of a random scene, whose start and goal are laid on the demonstration's, take
    the place of its own. Replays that touch a box are dropped, so what is left passes between the boxes as it did.

    Args:
        data: ``[N]``, as from :func:`record_demonstrations`; its episodes take turns.
        sampler: called as ``sampler(n, device=..., generator=...)`` for scenes in :class:`SceneSampler`'s frame.
        num: episodes to keep.
        world: the engine; tensors by default.
        seed: of the boxes.
        num_envs: episodes side by side.

    Returns:
        The transitions ``[N']`` of ``num`` episodes and the number of episodes tried for them.

    Raises:
        ValueError: if ``num`` is below 1, or nearly every replay touches a box.

    Examples:
        >>> from morlnav.navigation.demonstrations.record import record_demonstrations
        >>> from morlnav.navigation.modules import CircumnavigationOracle
        >>> from morlnav.navigation.world import SceneSampler
        >>> single, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(num_boxes=0), 1)
        >>> many, tries = replay_demonstrations(single, SceneSampler(num_boxes=2), 20)
        >>> many["episode"].unique().numel(), many["scene", "boxes"].shape[1:], tries > 20
        (20, torch.Size([2, 5]), True)
    """
    check_at_least(1, num=num)
    world, generator = world or TensorWorld(), torch.Generator().manual_seed(seed)
    episodes = [data[data["episode"] == number] for number in data["episode"].unique()]

    def attempt(batch: int, tries: int) -> TensorDict:
        turn = [episodes[(tries + i) % len(episodes)] for i in range(batch)]
        scene = _among_boxes(turn, sampler(len(turn), device=torch.device("cpu"), generator=generator), world)
        env = NavigationEnv(world, lambda *_, scene=scene, **__: scene, num_envs=len(turn), seed=seed)
        return _replay(turn, env, scene)

    return keep_successes(attempt, num, num_envs, "replays touched no box", "take fewer boxes")


def _among_boxes(turn: list[TensorDict], drawn: Scene, world: World) -> Scene:
    """The episodes' scenes with the boxes of others ``[B]``, but for boxes on start, goal or human."""
    scene = torch.stack([Scene.from_tensordict(episode["scene"][0]) for episode in turn])
    ahead = scene.goal - scene.start[:, :2]
    course = torch.atan2(ahead[:, 1], ahead[:, 0])
    boxes = drawn.boxes.cpu().clone()
    boxes[..., :2] = scene.start[:, None, :2] + to_frame(boxes[..., :2], torch.zeros(2), -course.unsqueeze(1))
    boxes[..., 4] += course.unsqueeze(1)
    for point, room in ((scene.start[:, :2], world.robot.radius), (scene.goal, 0.0), (scene.human, world.human_radius)):
        boxes[distance_to_box(point.unsqueeze(1), boxes) <= room] = torch.tensor(ABSENT)
    return Scene(start=scene.start, goal=scene.goal, human=scene.human, boxes=boxes, batch_size=scene.batch_size)


def _replay(turn: list[TensorDict], env: NavigationEnv, scene: Scene) -> TensorDict:
    """Roll-outs ``[B, T]`` of the executed actions, labelled with what was wanted."""
    wanted, executed = (
        pad_sequence([episode[key] for episode in turn], batch_first=True) for key in ("action", "executed_action")
    )
    again = roll_out(OpenLoop(executed), env, scene.to(env.device), None, executed.shape[1])
    return again.set("action", wanted[:, : again.shape[1]])
