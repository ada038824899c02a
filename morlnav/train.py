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
from omegaconf import DictConfig, OmegaConf

from morlnav import policy as policies
from morlnav.analysis import flat_settings, load_fronts
from morlnav.cli import conf_dir, duration, keep_freed_memory, one_sentence_errors, quiet, set_threads, stage
from morlnav.evaluate import evaluate_run, show_evaluation
from morlnav.record.loggers import TensorboardCSVLogger
from morlnav.trainers import make_trainer
from morlnav.trainers.drex import learn_demonstration_rewards
from morlnav.trainers.resume import load_checkpoint
from morlnav.trainers.workers import watched


def run(cfg: DictConfig, directory: Path) -> str | None:
    """Train as ``cfg`` says and leave everything in ``directory``; returns the table, or ``None`` if interrupted."""
    _check_device(cfg.device)
    checkpoint = None if cfg.resume is None else _checkpoint_of(Path(cfg.resume))
    keep_freed_memory()
    set_threads(cfg.threads)
    torch.manual_seed(cfg.seed)  # of the demonstration pipeline, and below of the training
    directory.mkdir(parents=True, exist_ok=True)
    logger = TensorboardCSVLogger("logs", directory)
    learn_demonstration_rewards(cfg, directory, logger)
    if checkpoint is not None and (directory / policies.CONFIG_FILE).is_file():
        _check_settings(cfg, directory)
    _keep_versions(directory / "versions.json", resumed=checkpoint is not None)
    OmegaConf.save(cfg, directory / policies.CONFIG_FILE, resolve=True)
    torch.manual_seed(cfg.seed)
    trainer = make_trainer(cfg, directory, logger)
    if checkpoint is not None:
        load_checkpoint(trainer, checkpoint)
        print(f"Continuing from {checkpoint} at {trainer.collected_frames} of {trainer.total_frames} frames.")
        if cfg.trainer.progress_bar:
            trainer.register_op("setup", lambda: trainer._pbar.update(trainer.collected_frames))

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


def _check_settings(cfg: DictConfig, directory: Path) -> None:
    """Nothing that the command line does not name may differ from what the run began with, as a new default would."""
    words = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    named = [word.lstrip("+~").split("=")[0] for word in words]
    began = flat_settings(OmegaConf.load(directory / policies.CONFIG_FILE), directory)
    now, written = (flat_settings(cfg, directory, resolve) for resolve in (True, False))
    changed = [
        f"{key}: {began.get(key, 'nothing')} then, {value} now"
        for key, value in now.items()
        if began.get(key, "nothing") != value
        and "${" not in str(written[key])  # what it refers to is compared
        and not key.endswith(".reward.path")  # the run may have been moved
        and not any(key == name or ("." in name and key.startswith(f"{name}.")) for name in named)
    ]
    if changed:
        raise ValueError(
            f"resume={cfg.resume}: defaults have changed since the run began ({'; '.join(changed)}); name these values "
            f"on the command line to go on."
        )


def _check_device(device: str) -> None:
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:  # PyTorch raises the latter where it was built without CUDA
        raise ValueError(f"device={device} cannot be used on this machine: {str(error).splitlines()[0]}") from error


def _checkpoint_of(path: Path) -> Path:
    from torchrl.checkpoint import Checkpoint, CheckpointRotation

    if Checkpoint.is_checkpoint(path):
        return path
    latest = CheckpointRotation(path / "checkpoints", keep_last=1).latest() if path.is_dir() else None
    if latest is None:
        raise FileNotFoundError(f"resume={path}: no checkpoint there; give a run directory that holds checkpoints/.")
    return latest


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


@hydra.main(version_base="1.3", config_path=conf_dir(), config_name="train")
def _main(cfg: DictConfig) -> float:
    directory = Path(HydraConfig.get().runtime.output_dir)
    if run(cfg, directory) is None:
        sys.exit(130)  # interrupted: a sweep ends here too
    return float(load_fronts(directory)["expected_utility"].iloc[0])  # what a sweeper may maximise


def _folders_of_configs(path: Path) -> list[str]:
    """The words that named other folders of configs when a run began; Hydra does not count them as its overrides."""
    if not path.is_file():
        return []
    settings = OmegaConf.load(path).hydra
    folders = [source.path for source in settings.runtime.config_sources if source.provider == "command-line"]
    searched = [word for word in settings.overrides.hydra if word.startswith("hydra.searchpath=")]
    return [*(word for folder in folders for word in ("--config-dir", folder)), *searched]


def main() -> None:
    """Entry point; ``resume=DIR`` continues there, with the overrides and config folders that it began with."""
    quiet()
    sys.path.insert(0, os.getcwd())  # so that a config may name classes from the user's folder
    # Under `uv run` Ray would give every worker an environment and a copy of this folder of its own.
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    resume = [word.split("=", 1)[1].strip("'\"") for word in sys.argv[1:] if word.startswith("resume=")]
    if resume:
        directory = Path(resume[-1])
        directory = directory.parent.parent if directory.parent.name == "checkpoints" else directory
        overrides = directory / ".hydra" / "overrides.yaml"
        if not overrides.is_file():
            sys.exit(f"resume={resume[-1]}: no run of morlnav-train there.")
        words = [*_folders_of_configs(overrides.with_name("hydra.yaml")), *OmegaConf.load(overrides), *sys.argv[1:]]
        words = [word for word in words if not word.startswith("resume=")]
        # Quoted, for a directory may have "=" and "," in its name.
        sys.argv[1:] = [*words, f"resume='{resume[-1]}'", f"hydra.run.dir='{directory}'"]
    if "HYDRA_FULL_ERROR" in os.environ:  # a developer wants the traceback
        return _main()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors reach us instead of Hydra's own report
    with one_sentence_errors():
        _main()


if __name__ == "__main__":
    main()
