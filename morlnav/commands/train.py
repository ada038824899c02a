"""``morlnav-train``: train a policy, evaluate it, and draw what it learned."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import nullcontext
from importlib.metadata import version
from pathlib import Path

import hydra
import torch
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import env_override
from omegaconf import DictConfig
from torchrl.checkpoint import CheckpointError
from torchrl.trainers import Trainer

from morlnav import deployment
from morlnav.cli import (
    conf_dir,
    duration,
    keep_freed_memory,
    one_sentence_errors,
    quiet,
    refuse_choices,
    refuse_misplaced,
)
from morlnav.config import setting
from morlnav.files import write_text
from morlnav.record.console import stage
from morlnav.runs import Run
from morlnav.runs.directory import TIMES_FILE, remove_leftovers, removed_if_empty, reserved, timed, times_of
from morlnav.runs.resuming import options_first, resumed_words
from morlnav.runs.run import prepare
from morlnav.runs.settings import Settings, is_sweep, refuse_without_clones
from morlnav.runs.sweeps import Sweeps
from morlnav.trainers import Training
from morlnav.trainers.checkpoint import find_checkpoints, load_checkpoint
from morlnav.trainers.collectors import watched

STOP = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""What asks a training to leave a checkpoint and end: Ctrl-C, a scheduler, a terminal that closes."""

SENTENCES = "MORLNAV_SENTENCES"
"""Set in the environment of this process and its workers where errors are to be one sentence, without a traceback."""


def run(cfg: DictConfig, directory: Path) -> Run | None:
    """Train as ``cfg`` says and leave everything in ``directory``; returns the run, or ``None`` if interrupted."""
    training, resume = prepare(cfg), cfg.resume
    keep_freed_memory()
    settings = Settings(cfg, directory)
    if resume is not None and settings.finished():
        print(f"{directory} has finished with these settings before; nothing is left to do.")
        finished = Run(directory, trust=True)
        finished.evaluation.show(directory / "evaluation", directory)
        return finished
    checkpoint = None if resume is None else _checkpoint_of(Path(resume))
    with tempfile.TemporaryDirectory() as scratch:
        training.rehearse(Path(scratch))  # all that constructors refuse, before anything is learned or written
    with reserved(directory):
        trainer = _begin(settings, training) if checkpoint is None else _continue(settings, training, checkpoint)
        _keep_versions(directory / "versions.json", resumed=checkpoint is not None)
        finished = _train(training, trainer, directory)
        if finished is not None:
            settings.finish(trainer.collected_frames)
        return finished


def _begin(settings: Settings, training: Training) -> Trainer:
    """A trainer at its start, with the rewards that are learned first."""
    settings.refuse_another_run()
    directory, logger = settings.directory, training.make_logger(settings.directory)
    settings.save()  # what is learned first belongs to it
    torch.manual_seed(training.seed)
    (directory / TIMES_FILE).unlink(missing_ok=True)  # of a run that left no checkpoint
    with timed(directory, "rewards"):
        learned = training.learn_rewards(directory, logger)
    trainer = training.make_trainer(directory, learned, logger)
    remove_leftovers(directory)
    return trainer


def _continue(settings: Settings, training: Training, checkpoint: Path) -> Trainer:
    """A trainer where a checkpoint left it; nothing is written until it is there."""
    settings.refuse_new_defaults()
    learned = training.restore_rewards(settings.directory)
    refuse_without_clones(learned, settings.directory)
    trainer = training.make_trainer(settings.directory, learned)
    try:
        checkpoint = load_checkpoint(trainer, checkpoint)
        if trainer.collected_frames >= trainer.total_frames:
            settings.refuse_to_change_a_finished_run()
        trainer.logger = training.make_logger(settings.directory)
    except BaseException as error:
        trainer.collector.shutdown()  # or its workers would stay
        if isinstance(error, CheckpointError):
            settings.refuse_what_does_not_fit(error)
        raise
    print(f"Continuing from {checkpoint} at {trainer.collected_frames} of {trainer.total_frames} frames.")
    if "rollout" not in trainer.checkpoint.components:
        print("Its episodes cannot be saved, so new ones begin; all else goes on as it was.")
    if trainer.progress_bar:
        trainer.register_op("setup", lambda: trainer._pbar.update(trainer.collected_frames))
    remove_leftovers(settings.directory)
    settings.save()
    return trainer


def _train(training: Training, trainer: Trainer, directory: Path) -> Run | None:
    interrupted = False

    def stop(*_: object) -> None:
        nonlocal interrupted
        if interrupted:  # a second signal does not wait
            sys.exit(130)
        interrupted = True
        trainer.request_stop("interrupted")

    asked = [number for number in STOP if signal.getsignal(number) != signal.SIG_IGN]  # nohup ignores hang-ups
    handlers = {number: signal.signal(number, stop) for number in asked}
    try:
        if trainer.collected_frames < trainer.total_frames:
            with watched(trainer.collector), timed(directory, "learning", goes_on=True) as note:
                trainer.register_op("post_steps", note)
                trainer.train()
    finally:
        if trainer.progress_bar and hasattr(trainer, "_pbar"):
            trainer._pbar.close()  # or its last line would run into the table
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if interrupted and trainer.collected_frames < trainer.total_frames:
        print(f"\nStopped after {trainer.collected_frames} frames; continue with: {_words_to_continue(directory)}")
        return None
    finished = Run(directory, trust=True)
    try:
        with timed(directory, "refinement"):
            policy = training.finish(trainer, finished.learned)
    except KeyboardInterrupt:
        print(f"\nStopped in the refinement, which begins anew with: {_words_to_continue(directory)}")
        return None
    deployment.save(policy, finished.evaluation.objectives, directory)
    times = times_of(directory)
    print(f"\nTrained for {duration(sum(times.values()) - times.get('evaluation', 0.0))}.")
    with stage("evaluation", setting(training.trainer, "progress_bar")), timed(directory, "evaluation"):
        finished.evaluation.report(finished.policy, directory / "evaluation")
    finished.evaluation.show(directory / "evaluation", directory)
    print(f"Everything is in {directory}")
    return finished


def _words_to_continue(directory: Path) -> str:
    if is_sweep():
        return f"the same words and hydra.sweep.dir={shlex.quote(HydraConfig.get().sweep.dir)}"
    return f"morlnav-train resume={shlex.quote(str(directory))}"


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
        try:
            began = dict(json.loads(path.read_text()))
        except (ValueError, TypeError, RecursionError):
            print(f"{path} is damaged, and begins anew; nothing depends on it.")
        else:
            now, versions, later = versions, began, began.pop("resumed", [])
            if now != (later or [versions])[-1]:
                later.append(now)
    write_text(path, json.dumps(versions | ({"resumed": later} if later else {}), indent=2))


@hydra.main(version_base="1.3", config_path=conf_dir(), config_name="train")
def _main(cfg: DictConfig) -> float:
    directory = Path(HydraConfig.get().runtime.output_dir)
    # Here too, for Hydra would add a line of its own to an error that leaves this function.
    with removed_if_empty(directory), one_sentence_errors() if os.environ.get(SENTENCES) else nullcontext():
        if is_sweep() and Settings(cfg, directory).begun():
            cfg.resume = str(directory)  # what the same words began before
        finished = run(cfg, directory)
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
    # Errors reach us instead of Hydra's report.
    with env_override({"HYDRA_FULL_ERROR": "1", SENTENCES: "1"}), one_sentence_errors():
        _run_words()


def _run_words() -> None:
    args = get_args_parser().parse_intermixed_args()
    refuse_choices([word for word in args.overrides if not word.startswith("resume=")])
    refuse_misplaced(args.overrides, args.multirun or "hydra.mode=MULTIRUN" in args.overrides)
    words, own_classes = resumed_words(sys.argv[1:])
    sys.argv[1:] = options_first(words)
    if own_classes:
        sys.path.insert(0, os.getcwd())  # so that a config may name classes from the user's folder
    try:
        _main()
    finally:
        Sweeps.forget_refused()


if __name__ == "__main__":
    main()
