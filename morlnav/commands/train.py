"""``morlnav-train``: train a policy, evaluate it, and draw what it learned."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
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

from morlnav import deployment
from morlnav.cli import conf_dir, duration, keep_freed_memory, one_sentence_errors, quiet, set_threads
from morlnav.config import check, plain, setting
from morlnav.record.progress import stage
from morlnav.runs import CONFIG_FILE, Run, make_training
from morlnav.runs.directory import remove_leftovers, reserved
from morlnav.runs.resuming import resumed_words
from morlnav.runs.run import OF_THE_COMMAND
from morlnav.runs.settings import (
    refuse_another_run,
    refuse_new_defaults,
    refuse_to_change_a_finished_run,
    refuse_what_does_not_fit,
    refuse_without_clones,
)
from morlnav.trainers import Training
from morlnav.trainers.checkpoint import find_checkpoints, load_checkpoint
from morlnav.trainers.workers import watched


def run(cfg: DictConfig, directory: Path) -> Run | None:
    """Train as ``cfg`` says and leave everything in ``directory``; returns the run, or ``None`` if interrupted."""
    config = plain(cfg)
    threads, resume = config.pop("threads"), config.pop("resume")
    check({name: value for name, value in config.items() if name not in OF_THE_COMMAND})
    keep_freed_memory()
    set_threads(threads)
    checkpoint = None if resume is None else _checkpoint_of(Path(resume))
    training = make_training(config)
    with (
        tempfile.TemporaryDirectory() as scratch
    ):  # all that constructors refuse, before anything is learned or written
        training.rehearse(Path(scratch))
    with reserved(directory):
        trainer = _begin(cfg, training, directory, checkpoint)
        return _train(training, trainer, directory)


def _begin(cfg: DictConfig, training: Training, directory: Path, checkpoint: Path | None) -> Trainer:
    """A trainer at its start, or where a checkpoint left it; nothing is written until a resumed one is there."""
    torch.manual_seed(training.seed)
    if checkpoint is None:
        refuse_another_run(cfg, directory)
        logger = training.make_logger(directory)
        trainer = training.make_trainer(directory, training.learn_rewards(directory, logger), logger)
    else:
        if (directory / CONFIG_FILE).is_file():
            refuse_new_defaults(cfg, directory)
        learned = training.restore_rewards(directory)
        refuse_without_clones(learned, directory)
        trainer = training.make_trainer(directory, learned)
        _continue(trainer, cfg, directory, checkpoint)
        trainer.logger = training.make_logger(directory)
    remove_leftovers(directory)
    _keep_versions(directory / "versions.json", resumed=checkpoint is not None)
    OmegaConf.save(cfg, directory / CONFIG_FILE, resolve=True)
    _keep_words(directory / ".hydra", OmegaConf.to_yaml(cfg))
    return trainer


def _continue(trainer: Trainer, cfg: DictConfig, directory: Path, checkpoint: Path) -> None:
    try:
        checkpoint = load_checkpoint(trainer, checkpoint)
        if trainer.collected_frames >= trainer.total_frames and (directory / CONFIG_FILE).is_file():
            refuse_to_change_a_finished_run(cfg, directory)
    except BaseException as error:
        trainer.collector.shutdown()  # or its workers would stay
        if isinstance(error, CheckpointError) and (directory / CONFIG_FILE).is_file():
            refuse_what_does_not_fit(cfg, directory, error)
        raise
    print(f"Continuing from {checkpoint} at {trainer.collected_frames} of {trainer.total_frames} frames.")
    if trainer.progress_bar:
        trainer.register_op("setup", lambda: trainer._pbar.update(trainer.collected_frames))


def _train(training: Training, trainer: Trainer, directory: Path) -> Run | None:
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
        if trainer.progress_bar and hasattr(trainer, "_pbar"):
            trainer._pbar.close()  # or its last line would run into the table
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if interrupted and trainer.collected_frames < trainer.total_frames:
        print(f"\nStopped after {trainer.collected_frames} frames; continue with: morlnav-train resume={directory}")
        return None
    finished = Run(directory, trust=True)
    deployment.save(trainer.checkpoint.components["average"].module, finished.evaluation.objectives, directory)
    print(f"\nTrained for {duration(time.perf_counter() - start)}.")
    with stage("evaluation", setting(training.trainer, "progress_bar")):
        finished.evaluation.report(finished.policy, directory / "evaluation")
    finished.evaluation.show(directory / "evaluation", directory)
    print(f"Everything is in {directory}")
    return finished


def _checkpoint_of(path: Path) -> Path:
    checkpoints = find_checkpoints(path)
    if not checkpoints:
        raise FileNotFoundError(f"resume={path}: no checkpoint there; give a run directory that holds checkpoints/.")
    return checkpoints[-1]


def _versions() -> dict[str, str]:
    names = ("morlnav", "torch", "torchrl", "tensordict", "gymnasium", "hydra-core", "pymunk", "numpy", "scipy")
    versions = {name: version(name) for name in names} | {"python": sys.version.split()[0]}
    checkout = Path(__file__).parents[2]
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
    finished = run(cfg, Path(HydraConfig.get().runtime.output_dir))
    if finished is None:
        sys.exit(130)  # interrupted: a sweep ends here too
    return finished.evaluation.utility(finished.directory / "evaluation")  # what a sweeper may maximise


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
