"""Demonstrations as files of trajectories, for other programs and for :func:`import_demonstrations`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import torch
from tensordict import TensorDict
from torch import Tensor

from morlnav.navigation.demonstrations.arrays import BOX
from morlnav.navigation.demonstrations.trajectory_file import COLUMNS, SCENE_COLUMNS
from morlnav.navigation.world import TensorWorld, World


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
        >>> from morlnav.navigation.demonstrations import import_demonstrations, record_demonstrations
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
