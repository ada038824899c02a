"""``morlnav-train``: train a policy, evaluate it, and draw what it learned."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import env_override
from omegaconf import DictConfig, OmegaConf
from torchrl.checkpoint import CheckpointError
from torchrl.trainers import Trainer

from morlnav.analysis import load_fronts
from morlnav.cli import conf_dir, duration, keep_freed_memory, one_sentence_errors, quiet, set_threads, stage
from morlnav.commands.evaluate import evaluate_run, show_evaluation
from morlnav.deployment import policy as policies
from morlnav.record.loggers import TensorboardCSVLogger
from morlnav.resuming import resumed_words
from morlnav.settings import (
    refuse_another_run,
    refuse_new_defaults,
    refuse_to_change_a_finished_run,
    refuse_what_does_not_fit,
)
from morlnav.trainers import make_trainer
from morlnav.trainers.drex import learn_demonstration_rewards
from morlnav.trainers.origins import refuse_other_rewards, use_kept_rewards, use_own_offsets
from morlnav.trainers.resume import load_checkpoint
from morlnav.trainers.run_directory import remove_leftovers, reserved
from morlnav.trainers.workers import watched


def run(cfg: DictConfig, directory: Path) -> str | None:
    """Train as ``cfg`` says and leave everything in ``directory``; returns the table, or ``None`` if interrupted."""
    _check_device(cfg.device)
    checkpoint = None if cfg.resume is None else _checkpoint_of(Path(cfg.resume))
    keep_freed_memory()
    set_threads(cfg.threads)
    with reserved(directory):
        return _train(cfg, directory, _begin(cfg, directory, checkpoint))


def _begin(cfg: DictConfig, directory: Path, checkpoint: Path | None) -> Trainer:
    """A trainer at its start, or where a checkpoint left it; nothing is written until a resumed one is there."""
    composed, resumed = OmegaConf.to_yaml(cfg), checkpoint is not None
    use_own_offsets(cfg)
    if resumed:
        use_kept_rewards(cfg, directory)
        if (directory / policies.CONFIG_FILE).is_file():
            refuse_new_defaults(cfg, directory)
        torch.manual_seed(cfg.seed)
        trainer = make_trainer(cfg, directory, None)
        _continue(trainer, cfg, directory, checkpoint)
        trainer.logger = TensorboardCSVLogger("logs", directory)
    else:
        refuse_another_run(cfg, directory)
        refuse_other_rewards(cfg, directory)
        torch.manual_seed(cfg.seed)  # of the demonstration pipeline, and below of the training
        logger = TensorboardCSVLogger("logs", directory)
        learn_demonstration_rewards(cfg, directory, logger)
        torch.manual_seed(cfg.seed)
        trainer = make_trainer(cfg, directory, logger)
    remove_leftovers(directory)
    _keep_versions(directory / "versions.json", resumed)
    OmegaConf.save(cfg, directory / policies.CONFIG_FILE, resolve=True)
    _keep_words(directory / ".hydra", composed)
    return trainer


def _continue(trainer: Trainer, cfg: DictConfig, directory: Path, checkpoint: Path) -> None:
    try:
        load_checkpoint(trainer, checkpoint)
        if trainer.collected_frames >= trainer.total_frames and (directory / policies.CONFIG_FILE).is_file():
            refuse_to_change_a_finished_run(cfg, directory)
    except BaseException as error:
        trainer.collector.shutdown()  # or its workers would stay
        if isinstance(error, CheckpointError) and (directory / policies.CONFIG_FILE).is_file():
            refuse_what_does_not_fit(cfg, directory, error)
        raise
    print(f"Continuing from {checkpoint} at {trainer.collected_frames} of {trainer.total_frames} frames.")
    if cfg.trainer.progress_bar:
        trainer.register_op("setup", lambda: trainer._pbar.update(trainer.collected_frames))


def _train(cfg: DictConfig, directory: Path, trainer: Trainer) -> str | None:
    interrupted = False

    def stop(*_: object) -> None:
        nonlocal interrupted
        if interrupted:  # a second signal does not wait
            sys.exit(130)
        interrupted = True
        trainer.request_stop("interrupted")

    handlers = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    start = time.perf_counter()
    try:
        if trainer.collected_frames < trainer.total_frames:
            with watched(trainer.collector):
                trainer.train()
    finally:
        if cfg.trainer.progress_bar and hasattr(trainer, "_pbar"):
            trainer._pbar.close()  # or its last line would run into the table
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if interrupted and trainer.collected_frames < trainer.total_frames:
        print(f"\nStopped after {trainer.collected_frames} frames; continue with: morlnav-train resume={directory}")
        return None
    policies.save(trainer.checkpoint.components["average"].module, directory)
    print(f"\nTrained for {duration(time.perf_counter() - start)}.")
    with stage("evaluation", cfg.trainer.progress_bar):
        table = evaluate_run(directory, trust=True)
    show_evaluation(directory)
    print(f"Everything is in {directory}")
    return table


def _check_device(device: str) -> None:
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:  # PyTorch raises the latter where it was built without CUDA
        raise ValueError(f"device={device} cannot be used on this machine: {str(error).splitlines()[0]}") from error


def _checkpoint_of(path: Path) -> Path:
    checkpoints = find_checkpoints(path)
    if not checkpoints:
        raise FileNotFoundError(f"resume={path}: no checkpoint there; give a run directory that holds checkpoints/.")
    return checkpoints[-1]


def _versions() -> dict[str, str]:
    names = ("morlnav", "torch", "torchrl", "tensordict", "gymnasium", "hydra-core", "pymunk", "numpy", "scipy")
    versions = {name: version(name) for name in names} | {"python": sys.version.split()[0]}
    checkout = Path(__file__).parents[1]
    if shutil.which("git") is None or not (checkout / ".git").exists():
        return versions
    git = ["git", "-C", str(checkout)]
    commit = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    if commit.returncode == 0:
        dirty = subprocess.run([*git, "status", "--porcelain"], capture_output=True, text=True, check=False)
        versions["git"] = commit.stdout.strip() + ("-dirty" if dirty.stdout.strip() else "")
    return versions


def _keep_versions(path: Path, resumed: bool) -> None:
    """Write what the run begins with; what it goes on with is added where it differs."""
    versions, later = _versions(), []
    if resumed and path.is_file():
        now, versions = versions, json.loads(path.read_text())
        later = versions.pop("resumed", [])
        if now != (later or [versions])[-1]:
            later.append(now)
    path.write_text(json.dumps(versions | ({"resumed": later} if later else {}), indent=2))


def _keep_words(folder: Path, composed: str) -> None:
    """What Hydra writes before a run has begun, written once it has; only if Hydra was told to leave that to us."""
    if not HydraConfig.initialized() or HydraConfig.get().output_subdir is not None:
        return
    folder.mkdir(exist_ok=True)
    (folder / "config.yaml").write_text(composed)
    (folder / "hydra.yaml").write_text(OmegaConf.to_yaml(OmegaConf.create({"hydra": HydraConfig.get()})))
    (folder / "overrides.yaml").write_text(OmegaConf.to_yaml(HydraConfig.get().overrides.task))


@hydra.main(version_base="1.3", config_path=conf_dir(), config_name="train")
def _main(cfg: DictConfig) -> float:
    directory = Path(HydraConfig.get().runtime.output_dir)
    if run(cfg, directory) is None:
        sys.exit(130)  # interrupted: a sweep ends here too
    return float(load_fronts(directory)["expected_utility"].iloc[0])  # what a sweeper may maximise


def main() -> None:
    """Entry point; ``resume=DIR`` continues there, with the overrides and config folders that it began with."""
    quiet()
    # Under `uv run` Ray would give every worker an environment and a copy of this folder of its own.
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    if "HYDRA_FULL_ERROR" in os.environ:  # a developer wants the traceback
        return _run_words()
    with env_override({"HYDRA_FULL_ERROR": "1"}), one_sentence_errors():  # errors reach us instead of Hydra's report
        _run_words()


def _run_words() -> None:
    sys.argv[1:], own_classes = resumed_words(sys.argv[1:])
    if own_classes:
        sys.path.insert(0, os.getcwd())  # so that a config may name classes from the user's folder
    _main()


if __name__ == "__main__":
    main()
