"""The open preferences of Bonn: which of two drives past a human people like better, asked in VR and on screens."""

from __future__ import annotations

import hashlib
import pickle
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pandas as pd
import torch
from tensordict import TensorDict

from morlnav.data.comparisons import ComparedPairs, Comparison, Snippet
from morlnav.navigation.world import World, without_human

INTERFACES = ("VR", "2D_TD", "2D_FPV")
SECTORS, REACH, SPEED = 60, 6.0, 1.0
"""The lidar's sectors and range in metres, and the robot's largest speed in m/s, of the study."""
COLUMNS = ("TrialNumber", "Preference", "data_path")
NUMBERS = {("collections", "OrderedDict"): OrderedDict, ("numpy", "ndarray"): np.ndarray, ("numpy", "dtype"): np.dtype,
           **{(f"numpy.{core}.multiarray", name): getattr(np._core.multiarray, name)
              for core in ("core", "_core") for name in ("_reconstruct", "scalar")}}  # fmt: skip
"""All that is built of what a pickle names."""


class BonnComparisons(ComparedPairs):
    """What people said in the study of de Heuvel et al. (IROS 2025), in the place of comparisons of one's own.

    The reward sees what the study's robot saw, but for its velocity: goal, human, and a lidar of 60 sectors up to 6 m.

    Args:
        path: of the unzipped data set, which holds ``user_feedback_data`` and ``dataset_<date>``.
        interface: ``VR``, ``2D_TD`` or ``2D_FPV``, through which they saw the drives; all by default.
        skip: participants to leave out; the authors leave out 27.
        share: of the reward's updates that learn from these pairs, and not from noise.
        batch_size: pairs of an update.
        held_out: share of the decided comparisons that is never trained on.
        world: the engine, whose lidar and speed have to be those of the study.
        observe_human: whether the reward sees the human's position (``-NH`` ablation).

    Raises:
        FileNotFoundError: if a file is missing.
        ValueError: if one is damaged, or the world is another.
    """

    def __init__(
        self,
        path: str,
        interface: str | None = None,
        skip: Sequence[int] = (27,),
        share: float = 0.5,
        batch_size: int = 16,
        held_out: float = 0.1,
        *,
        world: World | None = None,
        observe_human: bool = True,
    ) -> None:
        if world is not None:
            has = (world.lidar.sectors, world.lidar.max_range, world.robot.max_speed)
            if has != (SECTORS, REACH, SPEED):
                raise ValueError(
                    f"The study of Bonn had {SECTORS} sectors, {REACH:g} m and {SPEED:g} m/s, the world has {has[0]}, "
                    f"{has[1]:g} and {has[2]:g}; set env.world.lidar.sectors={SECTORS} "
                    f"env.world.lidar.max_range={REACH:g} env.world.robot.max_speed={SPEED:g}."
                )
        comparisons, data = read_bonn(path, interface, skip)
        if not observe_human:
            data["observation"] = without_human(data["observation"])
        super().__init__(comparisons, data, share, batch_size, held_out)
        content = [data["observation"].numpy().tobytes(), data["action"].numpy().tobytes(), repr(comparisons).encode()]
        self.key = hashlib.sha256(b"".join(content)).hexdigest()[:16]


def read_bonn(
    path: str | Path, interface: str | None = None, skip: Sequence[int] = (27,)
) -> tuple[list[Comparison], TensorDict]:
    """Read the data set of Bonn; of its pickles numbers alone are built, so that no code in them runs.

    Args:
        path: of the unzipped data set.
        interface: ``VR``, ``2D_TD`` or ``2D_FPV``; all by default.
        skip: participants to leave out.

    Returns:
        The comparisons, and transitions ``[N]`` with ``observation`` ``[64]`` (goal, human and lidar in m and rad),
        ``action`` ``[2]`` (m/s, rad/s) and ``episode``; every drive is one episode, whoever saw it.

    Raises:
        FileNotFoundError: if a file is missing.
        ValueError: naming the file, if it is damaged or of another layout.

    Examples:
        >>> read_bonn("nowhere")
        Traceback (most recent call last):
        FileNotFoundError: nowhere holds no user_feedback_data/user_study_results_id_*_block_*.csv.
    """
    path = Path(path)
    if interface not in (None, *INTERFACES):
        raise ValueError(f"There is no interface {interface}; choose from: {', '.join(INTERFACES)}.")
    pattern = f"user_feedback_data/user_study_results_id_*_block_{interface or '*'}.csv"
    skipped = tuple(f"user_study_results_id_{number}_block_" for number in skip)
    files = [file for file in sorted(path.glob(pattern)) if not file.name.startswith(skipped)]
    if not files:
        raise FileNotFoundError(f"{path} holds no {pattern}.")
    if copies := [file for file in files if not file.stem.endswith(tuple(f"_block_{name}" for name in INTERFACES))]:
        raise ValueError(f"{copies[0]} has no name of this study; is it a copy? Then leave it out.")
    comparisons, numbers, drives = [], {}, []
    for file in files:
        for place, trial, preferred in _answers(file):
            pair = [path / trial / f"Query_{letter}_state_action_reward.pkl" for letter in "AB"]
            for drive in pair:
                if drive not in numbers:
                    numbers[drive] = len(numbers)
                    drives.append(_drive(drive, numbers[drive], place))
            first, second = (Snippet(numbers[drive]) for drive in pair)
            comparisons.append(Comparison(first, second, {"A": "first", "B": "second"}[preferred]))
    if not drives:
        raise ValueError(f"{path} holds no comparisons.")
    return comparisons, torch.cat(drives)


def _answers(file: Path) -> list[tuple[str, PurePosixPath, str]]:
    """Where each answer stands, the folder of its two drives, and ``A`` or ``B``."""
    try:
        table = pd.read_csv(file)
    except (ValueError, OSError) as error:
        raise ValueError(f"{file} is no table: {error}") from error
    if missing := [name for name in COLUMNS if name not in table]:
        raise ValueError(f"{file}: expected a column {missing[0]}; the columns are {', '.join(map(str, table))}.")
    answers = []
    for row, (trial, preferred, folder) in enumerate(table[list(COLUMNS)].itertuples(index=False), 2):
        if trial == -1:  # for practice
            continue
        place = f"{file}, row {row}"
        if preferred not in ("A", "B"):
            raise ValueError(f"{place}, column Preference: expected A or B, got {preferred}.")
        answers.append((place, PurePosixPath(*PurePosixPath(str(folder).replace("\\", "/")).parts[-2:]), preferred))
    return answers


def _drive(file: Path, number: int, place: str) -> TensorDict:
    """The transitions ``[T]`` of a drive."""
    if not file.is_file():
        raise FileNotFoundError(f"{place}: there is no {file}.")
    try:
        with file.open("rb") as stream:
            content = _Numbers(stream).load()
        states, action = content["states"], np.asarray(content["actions"], np.float32)
        task = np.asarray([state["task_obs"] for state in states], np.float32)
        scan = np.asarray([state["scan"] for state in states], np.float32).reshape(len(states), -1)
    except Exception as error:  # of the many kinds that damaged pickles raise
        raise ValueError(
            f"{file} is no drive of this study: {type(error).__name__}: {error}".splitlines()[0]
        ) from error
    steps = len(action)
    shapes = {"states.task_obs": (task[:steps], (steps, 6)), "states.scan": (scan[:steps], (steps, SECTORS)),
              "actions": (action, (steps, 2))}  # fmt: skip
    for name, (values, shape) in shapes.items():
        if values.shape != shape or not steps or not np.isfinite(values).all():
            raise ValueError(f"{file}, {name}: expected finite numbers {list(shape)}, got {list(values.shape)}.")
    speed = action[:, 0]
    if scan.min() < 0 or scan.max() > 1 or speed.min() < -0.01 or speed.max() > 1.01 * SPEED:
        raise ValueError(f"{file}: expected scans from 0 to 1, and speeds up to {SPEED:g} m/s.")
    observation = np.concatenate([task[:steps, :4], REACH * scan[:steps]], 1)
    return TensorDict(
        observation=torch.from_numpy(observation),
        action=torch.from_numpy(action),
        episode=torch.full((steps,), number),
        batch_size=[steps],
    )


class _Left:
    """Stands for whatever else a pickle holds."""

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def __setstate__(self, state: Any) -> None: ...

    def __setitem__(self, key: Any, value: Any) -> None: ...

    def append(self, value: Any) -> None: ...

    def extend(self, values: Any) -> None: ...


class _Numbers(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        return NUMBERS.get((module, name), _Left)
