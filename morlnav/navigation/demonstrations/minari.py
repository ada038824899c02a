"""Demonstrations as data sets of Minari, and such data sets as demonstrations."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from morlnav.navigation.demonstrations.folder import check_drives, join_demonstrations
from morlnav.navigation.registration import ENV_ID
from morlnav.navigation.world import TensorWorld, World

ENDS = ("goal", "human", "box")
NAME = re.compile(r"([\w-]+/)*[\w-]+-v\d+", re.ASCII)


def to_minari(data: TensorDict, name: str, world: World | None = None, **about: Any) -> None:
    """Keep demonstrations as a local Minari data set.

    Observations are raw ``[T + 1, 34]``, actions those that were executed ``[T, 2]``, rewards the sum over objectives;
    an episode ends terminated. Its infos hold, for every observation, what demonstrations need beyond: ``pose``,
    ``scene``, ``goal``, ``human`` and ``box``, as those of the Gymnasium environment do, and the ``label``.

    Args:
        data: ``[N]``, as from :func:`~morlnav.navigation.demonstrations.record_demonstrations`.
        name: of the data set, such as ``"navigation/mine-v0"``.
        world: that they were driven in, which tells the spaces; tensors by default.
        about: ``author`` and whatever else ``minari.create_dataset_from_buffers`` takes.

    Raises:
        ValueError: without the package ``minari``, for a data set that is there, or demonstrations of another world.
    """
    minari = _minari()
    from minari.data_collector import EpisodeBuffer

    from morlnav.navigation.envs import NavigationEnv
    from morlnav.navigation.envs.gym import _spaces

    world = world or TensorWorld()
    is_there = _is_there(minari, name)
    check_drives(data, name, world)
    if is_there:
        raise ValueError(f"There is a Minari data set {name} already; choose another name, such as the next version.")
    buffers = []
    for number in data["episode"].unique().tolist():
        drive = data[data["episode"] == number]
        after = drive["next"]
        both = {key: torch.cat([drive[key], after[key][-1:]]).numpy() for key in ("observation", "pose")}
        scene = {key: _on(value).numpy() for key, value in drive["scene"].items()}
        flags = {end: np.append(False, after["outcome", end].flatten().numpy()) for end in ENDS}
        rewards = after.get("reward", torch.zeros(len(drive), 1)).sum(-1).double().tolist()
        done = after["done"].flatten().tolist()
        buffers.append(
            EpisodeBuffer(
                id=len(buffers),
                observations=list(both["observation"]),
                actions=list(drive["executed_action"].numpy()),
                rewards=rewards,
                terminations=done,
                truncations=[False] * (len(done) - 1) + [not done[-1]],
                infos={"pose": both["pose"], "scene": scene, "label": _on(drive["action"]).numpy(), **flags},
            )
        )
    observation, action, _ = _spaces(NavigationEnv(world, num_envs=1, seed=0))
    spaces = {"observation_space": observation, "action_space": action}
    minari.create_dataset_from_buffers(name, buffers, env=ENV_ID, **spaces, **about)


def from_minari(name: str, world: World | None = None, tell: Callable[[str], None] = print) -> TensorDict:
    """Demonstrations of a local Minari data set, as :func:`to_minari` or ``minari.DataCollector`` made it.

    The collector keeps what is needed with ``DataCollector(env, record_infos=True)`` around the Gymnasium environment
    ``morlnav/SocialNavigation-v0``. Episodes that do not reach the goal are left out, which is told.

    Args:
        name: of the data set.
        world: that they were driven in; tensors by default.
        tell: called with a line that says what was read.

    Returns:
        ``[N]`` as from :func:`~morlnav.navigation.demonstrations.record_demonstrations`, without rewards.

    Raises:
        ValueError: without the package ``minari``, for an unknown data set, one without poses and scenes, or one of
            another world.
    """
    minari, world = _minari(), world or TensorWorld()
    if not _is_there(minari, name):
        raise ValueError(f"There is no local Minari data set {name}; minari download {name} may fetch it.")
    episodes, left, missing = [], 0, []
    try:
        for episode in minari.load_dataset(name).iterate_episodes():
            if missing := [key for key in ("pose", "scene", *ENDS) if key not in (episode.infos or {})]:
                break
            if episode.infos["goal"][-1]:
                episodes.append(_demonstration(episode, len(episodes)))
            else:
                left += 1
    except Exception as error:  # of the many kinds that damaged storage raises
        what = f"{type(error).__name__}: {error}".splitlines()[0]
        raise ValueError(f"The Minari data set {name} is damaged: {what}") from error
    if missing:
        raise ValueError(
            f"The Minari data set {name} keeps no {missing[0]} in its infos; collect with "
            f"DataCollector(env, record_infos=True) from {ENV_ID}."
        )
    if not episodes:
        raise ValueError(f"Of the {left} episodes of the Minari data set {name}, none reaches the goal.")
    data = join_demonstrations(episodes)
    if wrong := [key for key, value in data.items(True, True) if not value.isfinite().all()]:
        raise ValueError(f"The Minari data set {name} is damaged: its {wrong[0]} is not finite.")
    check_drives(data, f"the Minari data set {name}", world)
    kept = f"{len(episodes)} episodes of {len(data) * world.step_time:.1f} s"
    tell(f"{name}: {kept}, {data['action'][:, 0].mean():.2f} m/s on average; {left} that do not arrive left out.")
    return data


def _is_there(minari: Any, name: str) -> bool:
    """Whether there is a local data set of this name.

    Raises:
        ValueError: for a name that none can have, for a damaged one, or if Minari stumbles over another one.
    """
    from minari.storage import get_dataset_path

    if not NAME.fullmatch(name):
        raise ValueError(f"A Minari data set has a name such as navigation/mine-v0, with a version, got {name!r}.")
    try:
        with warnings.catch_warnings(action="ignore"):  # of other data sets that are damaged
            is_listed = name in minari.list_local_datasets()
    except Exception as error:
        what = f"{type(error).__name__}: {error}".splitlines()[0]
        raise ValueError(f"The local Minari data sets cannot be listed, for one is damaged: {what}") from error
    if not is_listed and (folder := get_dataset_path(name)).exists():
        raise ValueError(f"The Minari data set {name} is damaged: what lies in {folder} is none.")
    return is_listed


def _demonstration(episode: Any, number: int) -> TensorDict:
    steps = len(episode.actions)
    observation, action = (torch.as_tensor(np.asarray(value)) for value in (episode.observations, episode.actions))
    infos = {key: torch.as_tensor(np.asarray(episode.infos[key])) for key in ("pose", *ENDS)}
    scene = {key: torch.as_tensor(np.asarray(value))[:steps] for key, value in episode.infos["scene"].items()}
    label = torch.as_tensor(np.asarray(episode.infos["label"]))[:steps] if "label" in episode.infos else action
    done = torch.as_tensor(np.asarray(episode.terminations)).unsqueeze(-1)
    outcome = {end: infos[end][1:].unsqueeze(-1) for end in ENDS}
    following = {"observation": observation[1:], "pose": infos["pose"][1:], "scene": scene, "outcome": outcome}
    return TensorDict(
        {
            "observation": observation[:-1],
            "action": label,
            "executed_action": action,
            "pose": infos["pose"][:-1],
            "scene": scene,
            "episode": torch.full((steps,), number),
            "step": torch.arange(steps),
            "next": {**following, "done": done, "terminated": done.clone()},
        },
        [steps],
    ).clone()


def _on(value: torch.Tensor) -> torch.Tensor:
    """Steps ``[T]`` and the last of them again, as many as there are observations."""
    return torch.cat([value, value[-1:]])


def _minari() -> Any:
    try:
        import minari
    except ImportError as error:
        raise ValueError("Minari data sets need the package minari: pip install 'morlnav[minari]'") from error
    return minari
