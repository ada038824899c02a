"""Whether the outputs in a directory belong to a config."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from morlnav.analysis import flat_settings
from morlnav.deployment.policy import POLICY_FILE
from morlnav.runs.config import CONFIG_FILE, load_config
from morlnav.trainers.drex import CLONE_FILE, LearnedReward

NO_RESULT_DEPENDS_ON = ("cache", "trainer.progress_bar")


def changed_settings(cfg: DictConfig, directory: Path, counts: Callable[[str], bool] = lambda key: True) -> list[str]:
    """What a config says otherwise than that of the run in a directory, as ``seed: 0 then, 5 now``.

    Args:
        cfg: the config.
        directory: of the run.
        counts: which keys to compare; what no result depends on never counts.

    Examples:
        >>> import tempfile
        >>> run = Path(tempfile.mkdtemp())
        >>> OmegaConf.save({"seed": 0, "cache": "here"}, run / "config.yaml")
        >>> changed_settings(OmegaConf.create({"seed": 5, "cache": "there"}), run)
        ['seed: 0 then, 5 now']
    """
    began, now = flat_settings(load_config(directory), directory), flat_settings(cfg, directory)
    return [
        f"{key}: {began.get(key, 'nothing')} then, {now.get(key, 'nothing')} now"
        for key in dict.fromkeys([*now, *began])
        if began.get(key, "nothing") != now.get(key, "nothing") and key not in NO_RESULT_DEPENDS_ON and counts(key)
    ]


def refuse_another_run(cfg: DictConfig, directory: Path) -> None:
    """Refuse to begin a run where one has begun, lest its outputs pass for those of this config.

    One that was killed before its first checkpoint may begin anew.

    Raises:
        ValueError: naming the directory and what it holds.
    """
    kept = [name for name in (POLICY_FILE, "checkpoints") if (directory / name).exists()]
    if not kept and not (directory / CONFIG_FILE).is_file():
        return
    load_config(directory)  # names a config that is missing or damaged
    if changed := changed_settings(cfg, directory):
        raise ValueError(f"{directory} holds a run of another config ({_some(changed)}); choose another hydra.run.dir.")
    if kept:
        raise ValueError(
            f"{directory} holds {kept[0]} of this run already; continue it with resume={directory}, or choose another "
            f"hydra.run.dir."
        )


def refuse_new_defaults(cfg: DictConfig, directory: Path) -> None:
    """Nothing that the command line does not name may differ from what the run began with, as a new default would.

    Raises:
        ValueError: naming what differs.
    """
    words = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    named = [word.lstrip("+~").split("=")[0] for word in words]
    written = flat_settings(cfg, directory, resolve=False)

    def counts(key: str) -> bool:
        return (
            key in written
            and "${" not in str(written[key])  # what it refers to is compared
            and not any(key == name or ("." in name and key.startswith(f"{name}.")) for name in named)
        )

    if changed := changed_settings(cfg, directory, counts):
        raise ValueError(
            f"resume={cfg.resume}: defaults have changed since the run began ({'; '.join(changed)}); name these values "
            f"on the command line to go on."
        )


def refuse_without_clones(learned: Mapping[str, LearnedReward], directory: Path) -> None:
    """A run can be measured without the clones of its demonstrators, but they guide the actor while it learns.

    Raises:
        ValueError: naming the first objective that lacks its own.
    """
    if lacking := [name for name, reward in learned.items() if reward.clone is None]:
        raise ValueError(
            f"{directory} keeps no {CLONE_FILE} of {lacking[0]}, which learning needs; begin a run of its own."
        )


def refuse_to_change_a_finished_run(cfg: DictConfig, directory: Path) -> None:
    """What has been learned does not change with its config.

    Raises:
        ValueError: naming what differs.
    """
    if changed := changed_settings(cfg, directory):
        raise ValueError(
            f"resume={cfg.resume}: the run has finished, and other settings ({_some(changed)}) would change nothing; "
            f"train with them in a directory of its own, or longer with trainer.total_frames."
        )


def refuse_what_does_not_fit(cfg: DictConfig, directory: Path, error: Exception) -> None:
    """Say which settings differ where a checkpoint cannot be loaded, for they may be why.

    Raises:
        ValueError: if any differ.
    """
    if changed := changed_settings(cfg, directory):
        raise ValueError(
            f"resume={cfg.resume}: the checkpoint does not load with other settings ({_some(changed)}); leave them as "
            f"they were, or begin a run of its own: {error}"
        ) from error


def _some(changed: list[str]) -> str:
    return "; ".join([*changed[:3], *([f"{len(changed) - 3} more"] if len(changed) > 3 else [])])
