"""Whether the outputs in a directory belong to a config."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from morlnav.deployment.policy import POLICY_FILE
from morlnav.files import write_text
from morlnav.modules import read_facts, write_facts
from morlnav.runs.config import CONFIG_FILE, flat_settings, load_config
from morlnav.trainers.checkpoint import find_checkpoints
from morlnav.trainers.drex import CLONE_FILE, REWARD_FILE, LearnedReward

NO_RESULT_DEPENDS_ON = ("cache", "trainer.progress_bar")


class Settings:
    """A composed config, beside what a directory may hold of a run.

    Args:
        cfg: as Hydra composed it.
        directory: of the run.

    Examples:
        >>> import tempfile
        >>> from omegaconf import OmegaConf
        >>> run = Path(tempfile.mkdtemp())
        >>> OmegaConf.save({"seed": 0, "cache": "here"}, run / "config.yaml")
        >>> Settings(OmegaConf.create({"seed": 5, "cache": "there"}), run).changed()
        ['seed: 0 then, 5 now']
    """

    def __init__(self, cfg: DictConfig, directory: Path) -> None:
        self.cfg, self.directory = cfg, directory

    def save(self) -> None:
        """Write the config into the directory, and Hydra's own files if Hydra was told to leave that to us."""
        write_text(self.directory / CONFIG_FILE, OmegaConf.to_yaml(self.cfg, resolve=True))
        if not HydraConfig.initialized() or HydraConfig.get().output_subdir is not None:
            return
        folder, hydra = self.directory / ".hydra", HydraConfig.get()
        folder.mkdir(exist_ok=True)
        write_text(folder / "config.yaml", OmegaConf.to_yaml(self.cfg))
        write_text(folder / "hydra.yaml", OmegaConf.to_yaml(OmegaConf.create({"hydra": hydra})))
        write_text(folder / "overrides.yaml", OmegaConf.to_yaml(hydra.overrides.task))

    def changed(self, counts: Callable[[str], bool] = lambda key: True) -> list[str]:
        """What the config says otherwise than that of the run in the directory, as ``seed: 0 then, 5 now``.

        Args:
            counts: which keys to compare; what no result depends on never counts, nor does a part that one of both
                does not know and the other leaves out.
        """
        if not (self.directory / CONFIG_FILE).is_file():
            return []
        began = flat_settings(load_config(self.directory), self.directory)
        now = flat_settings(OmegaConf.to_container(self.cfg, resolve=True), self.directory)
        return [
            f"{key}: {began.get(key, 'nothing')} then, {now.get(key, 'nothing')} now"
            for key in dict.fromkeys([*now, *began])
            if began.get(key) != now.get(key) and key not in NO_RESULT_DEPENDS_ON and counts(key)
        ]

    def finish(self, frames: int) -> None:
        """Note that the policy of so many frames is refined, saved and measured."""
        file = self.directory / POLICY_FILE
        write_facts(file, read_facts(file) | {"frames": frames})

    def finished(self) -> bool:
        """Whether a run has finished here with this config, and what it left is whole."""
        if not all((self.directory / name).is_file() for name in (CONFIG_FILE, "evaluation/table.md")):
            return False
        with suppress(ValueError, OSError):  # a policy that is missing or damaged is made anew
            frames = read_facts(self.directory / POLICY_FILE).get("frames", -1)
            return frames >= OmegaConf.select(self.cfg, "trainer.total_frames", default=0) and not self.changed()
        return False

    def begun(self) -> bool:
        """Whether a run with this config has finished here, or left a checkpoint to go on from."""
        same = (self.directory / CONFIG_FILE).is_file() and not self.changed()
        return same and (self.finished() or bool(find_checkpoints(self.directory)))

    def refuse_another_run(self) -> None:
        """Refuse to begin a run where one has begun, lest its outputs pass for those of this config.

        One that was killed before its first checkpoint may begin anew.

        Raises:
            ValueError: naming the directory and what it holds.
        """
        kept = [name for name in (POLICY_FILE, "checkpoints") if (self.directory / name).exists()]
        begun = [name for name in (CONFIG_FILE, REWARD_FILE) if (self.directory / name).is_file()]
        if not kept and not begun:
            return
        load_config(self.directory)  # names a config that is missing or damaged
        other = f"choose another hydra.{'sweep' if is_sweep() else 'run'}.dir."
        if changed := self.changed():
            raise ValueError(f"{self.directory} holds a run of another config ({_some(changed)}); {other}")
        if kept:
            raise ValueError(
                f"{self.directory} holds {kept[0]} of this run already; continue it with resume={self.directory}, or "
                f"{other}"
            )

    def refuse_new_defaults(self) -> None:
        """Nothing that the command line does not name may differ from what the run began with, as a new default would.

        Raises:
            ValueError: naming what differs.
        """
        words = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
        named = [word.lstrip("+~").split("=")[0] for word in words]
        written = flat_settings(OmegaConf.to_container(self.cfg, resolve=False), self.directory)

        def counts(key: str) -> bool:
            return (
                key in written
                and "${" not in str(written[key])  # what it refers to is compared
                and not any(key == name or ("." in name and key.startswith(f"{name}.")) for name in named)
            )

        if changed := self.changed(counts):
            raise ValueError(
                f"resume={self.cfg.resume}: defaults have changed since the run began ({'; '.join(changed)}); name "
                f"these values on the command line to go on."
            )

    def refuse_to_change_a_finished_run(self) -> None:
        """What has been learned does not change with its config.

        Raises:
            ValueError: naming what differs.
        """
        if changed := self.changed():
            raise ValueError(
                f"resume={self.cfg.resume}: the run has finished, and other settings ({_some(changed)}) would change "
                f"nothing; train with them in a directory of its own, or longer with trainer.total_frames."
            )

    def refuse_what_does_not_fit(self, error: Exception) -> None:
        """Say which settings differ where a checkpoint cannot be loaded, for they may be why.

        Raises:
            ValueError: if any differ.
        """
        if changed := self.changed():
            raise ValueError(
                f"resume={self.cfg.resume}: the checkpoint does not load with other settings ({_some(changed)}); leave "
                f"them as they were, or begin a run of its own: {error}"
            ) from error


def is_sweep() -> bool:
    """Whether this run is a job of a sweep (``-m``)."""
    return HydraConfig.initialized() and HydraConfig.get().mode is RunMode.MULTIRUN


def refuse_without_clones(learned: Mapping[str, LearnedReward], directory: Path) -> None:
    """A run can be measured without the clones of its demonstrators, but they guide the actor while it learns.

    Raises:
        ValueError: naming the first objective that lacks its own.
    """
    if lacking := [name for name, reward in learned.items() if reward.clone is None]:
        raise ValueError(
            f"{directory} keeps no {CLONE_FILE} of {lacking[0]}, which learning needs; begin a run of its own."
        )


def _some(changed: list[str]) -> str:
    return "; ".join([*changed[:3], *([f"{len(changed) - 3} more"] if len(changed) > 3 else [])])
