"""Roll-outs of a navigating policy that people compare: recording them, the page that asks, and what was answered."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path

import torch
from tensordict import TensorDict
from torch import Tensor

from morlnav.data.comparisons import ComparedPairs, read_comparisons
from morlnav.files import sha256
from morlnav.limits import check_at_least
from morlnav.modules.mode import eval_mode
from morlnav.navigation.demonstrations import demonstrations_digest, recorded_demonstrations
from morlnav.navigation.demonstrations.record import roll_out, successes
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.world import Scene, World, without_human

COMPARISONS_FILE = "comparisons.jsonl"
PAGE = Path(__file__).with_name("comparisons.html")


class RecordedComparisons(ComparedPairs):
    """What people said of roll-outs in a folder, as ``morlnav-compare`` writes it.

    Args:
        path: of a folder of demonstrations; comparisons name its episodes.
        file: of comparisons (:func:`~morlnav.data.comparisons.read_comparisons`); ``comparisons.jsonl`` in the folder
            by default.
        share: of the reward's updates that learn from these pairs, and not from noise.
        batch_size: pairs of an update.
        held_out: share of the decided comparisons that is never trained on.
        world: the engine, whose lidar the roll-outs have to be seen by.
        observe_human: whether the reward sees the human's position (``-NH`` ablation).

    Raises:
        FileNotFoundError: if the folder holds no demonstrations, or the file is missing.
        ValueError: if they are damaged, or do not fit each other.
    """

    def __init__(
        self,
        path: str,
        file: str | None = None,
        share: float = 0.5,
        batch_size: int = 16,
        held_out: float = 0.1,
        *,
        world: World | None = None,
        observe_human: bool = True,
    ) -> None:
        answers = Path(file) if file is not None else Path(path) / COMPARISONS_FILE
        comparisons = read_comparisons(answers)
        data, _ = recorded_demonstrations(path, world=world, observe_human=observe_human)
        try:
            super().__init__(comparisons, data.set("action", data["executed_action"]), share, batch_size, held_out)
        except ValueError as error:
            raise ValueError(f"{answers}: {error}") from error
        self.key = f"{demonstrations_digest(path)} {sha256(answers)[:16]}"


@torch.no_grad()
def record_styles(
    policy: Callable[[Tensor, Tensor], Tensor],
    scenes: Scene,
    preferences: Tensor,
    *,
    world: World,
    observe_human: bool = True,
    max_steps: int = 250,
) -> TensorDict:
    """Every preference in every scene as demonstrations, however the episodes end.

    Args:
        policy: maps observations ``[B, D]`` and preferences ``[B, n]`` to actions ``[B, 2]``.
        scenes: batched ``[S]``.
        preferences: λ, ``[P, n]``.
        world: the engine.
        observe_human: whether the policy is told of the human.
        max_steps: time limit.

    Returns:
        Transitions ``[N]``, as from :func:`~morlnav.navigation.demonstrations.record_demonstrations`; episode
        ``p·S + s`` is preference ``p`` in scene ``s``.

    Examples:
        >>> from morlnav.navigation.evaluation import evaluation_scenes
        >>> from morlnav.navigation.world import TensorWorld
        >>> straight = lambda observation, preference: torch.tensor([0.5, 0.0]).expand(len(observation), 2)
        >>> data = record_styles(straight, evaluation_scenes(2), torch.eye(2), world=TensorWorld(), max_steps=5)
        >>> data["episode"].unique().tolist(), data["observation"].shape
        ([0, 1, 2, 3], torch.Size([20, 34]))
    """
    count, weights = len(scenes), preferences.repeat_interleave(len(scenes), 0)
    scene = torch.cat([scenes] * len(preferences))
    env = NavigationEnv(world, lambda *_, **__: scene, num_envs=len(scene), seed=0)

    def drive(observation: Tensor) -> Tensor:
        return policy(observation if observe_human else without_human(observation), weights)

    with eval_mode(policy):
        episodes = roll_out(drive, env, scene, None, max_steps)
    driven, _ = successes(episodes)
    episodes["episode"] = torch.arange(len(preferences) * count).unsqueeze(1).expand(driven.shape).clone()
    return episodes[driven]


def draw_pairs(scenes: int, preferences: int, num: int, seed: int = 0) -> list[tuple[int, int]]:
    """Episodes of :func:`record_styles` to compare: each pair in one scene, under two preferences.

    Args:
        scenes: number of scenes ``S``.
        preferences: number of preferences ``P``.
        num: pairs that are wanted; there are at most ``S·P·(P - 1)/2``.
        seed: of the draw.

    Raises:
        ValueError: if there are not so many, or no scenes.

    Examples:
        >>> draw_pairs(scenes=1, preferences=3, num=3)
        [(2, 1), (1, 0), (2, 0)]
    """
    check_at_least(1, scenes=scenes)
    styles = list(combinations(range(preferences), 2))
    every = [(first * scenes + s, second * scenes + s) for first, second in styles for s in range(scenes)]
    if not 1 <= num <= len(every):
        raise ValueError(f"{preferences} preferences in {scenes} scenes make 1 to {len(every)} pairs, got {num}.")
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.randperm(len(every), generator=generator)[:num].tolist()
    flip = torch.rand(num, generator=generator) < 0.5
    return [every[i][::-1] if turned else every[i] for i, turned in zip(chosen, flip.tolist(), strict=True)]


def write_page(data: TensorDict, pairs: Sequence[tuple[int, int]], file: Path, world: World) -> None:
    """A page that shows pairs of roll-outs in motion, asks which is better, and offers the answers as a file.

    It needs nothing but a browser, and fetches nothing.

    Args:
        data: transitions ``[N]``, as from :func:`record_styles`.
        pairs: of episodes.
        file: ends with ``.html``.
        world: that they were driven in, for its radii and step time.
    """
    episodes = {}
    for number in sorted({episode for pair in pairs for episode in pair}):
        rows = data[data["episode"] == number]
        scene = {name: value.tolist() for name, value in rows["scene"][0].items()}
        path = torch.cat([rows["pose"], rows["next", "pose"][-1:]])
        episodes[number] = scene | {"path": [[round(entry, 3) for entry in pose] for pose in path.tolist()]}
    content = {
        "pairs": pairs,
        "episodes": episodes,
        "robot": world.robot.radius,
        "human": world.human_radius,
        "step": world.step_time,
    }
    file.write_text(PAGE.read_text(encoding="utf-8").replace("{CONTENT}", json.dumps(content)), encoding="utf-8")
