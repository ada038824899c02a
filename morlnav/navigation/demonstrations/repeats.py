"""Demonstrations that are there already; two copies of a drive would count twice as much as any other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from tensordict import TensorDict

from morlnav.navigation.demonstrations.folder import HEADER, join_demonstrations, load_demonstrations

SAME = 0.005
"""Metres within which two drives are one, read from two files; nobody drives the same way twice so exactly."""
SCENE = ("goal", "human", "boxes")


def repeats(parts: Sequence[TensorDict]) -> dict[int, int]:
    """Episodes that an earlier part holds already: the same drive in the same scene.

    Args:
        parts: ``[N_i]`` each, as from :func:`~morlnav.navigation.demonstrations.record_demonstrations`.

    Returns:
        The earlier episode by the number of the later one, as :func:`join_demonstrations` numbers them.

    Examples:
        >>> from morlnav.navigation.demonstrations import record_demonstrations
        >>> from morlnav.navigation.modules import CircumnavigationOracle
        >>> from morlnav.navigation.world import SceneSampler
        >>> data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 2)
        >>> repeats([data]), repeats([data, data])
        ({}, {2: 0, 3: 1})
    """
    data, counts = join_demonstrations(parts), [int(part["episode"].unique().numel()) for part in parts]
    part = np.repeat(np.arange(len(counts)), counts)
    episodes = data.split(data["episode"].unique_consecutive(return_counts=True)[1].tolist())
    facts = [[one["pose"][:, :2].mean(0), *(one["scene", name][0] for name in SCENE)] for one in episodes]
    told = torch.stack([torch.cat([fact.flatten() for fact in each]) for each in facts])
    found: dict[int, int] = {}
    for earlier, later in sorted(cKDTree(told.numpy()).query_pairs(SAME, p=np.inf)):
        ours, theirs = (episodes[number]["pose"][:, :2] for number in (later, earlier))
        if part[earlier] < part[later] and len(ours) == len(theirs) and (ours - theirs).abs().max() < SAME:
            found.setdefault(later, earlier)
    return found


def new_episodes(parts: Sequence[TensorDict], path: Path, good_only: bool = False) -> tuple[TensorDict, int]:
    """Of some demonstrations those that a folder does not hold yet, each once.

    Args:
        parts: ``[N_i]`` each, which shall be added to it.
        path: of the folder, which need not be there.
        good_only: leave the others out, instead of refusing them all.

    Returns:
        Those ``[N]``, and how many episodes are left out.

    Raises:
        ValueError: if all are there already, or some are and ``good_only`` does not say to leave them out.
    """
    held = [load_demonstrations(path)] if (path / HEADER).is_file() else []
    if len({part["observation"].shape[-1] for part in [*held, *parts]}) > 1 or not (again := repeats([*held, *parts])):
        return join_demonstrations(parts), 0  # of other widths they are refused where they would be added
    whole, count = join_demonstrations([*held, *parts]), sum(int(part["episode"].max()) + 1 for part in held)
    tried = int(whole["episode"].max()) + 1 - count
    if not good_only or len(again) == tried:
        some = f"all {tried} episodes" if len(again) == tried else f"{len(again)} of {tried} episodes"
        where = f"{path} already holds {some}" if min(again.values()) < count else f"{some} are there twice"
        advice = "; --good-only adds the others" if len(again) < tried else ""
        raise ValueError(f"{where}, the same drives in the same scenes{advice}.")
    left = torch.tensor([*range(count), *again])
    return whole[~torch.isin(whole["episode"], left)], len(again)
