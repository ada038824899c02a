"""Kill trainings at random moments, and see that each goes on to the result of one that nobody killed.

``python -m benchmarks.kills --trials 50`` kills ``trainer=smoke`` with demonstrations by ``SIGKILL``, from its start to
its report. The same command, or ``resume=``, then has to end with the same policy, reward and evaluation, bit for bit.
"""

from __future__ import annotations

import argparse
import filecmp
import json
import os
import random
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path

import psutil
import torch

from morlnav.cli import composed, one_sentence_errors, quiet, set_threads
from morlnav.commands.train import run
from morlnav.trainers.checkpoint import find_checkpoints

BRIEF = (
    "env.scenes.distance=[5,6]",
    "rewards.num=4",
    "rewards.ranking.episodes=2",
    "rewards.ranking.held_out=0.5",
    "rewards.ranking.members=[[observation],[observation,action]]",
    "rewards.audit.num_scenes=2",
    "evaluation.episodes=2",
    "evaluation.steps=1",
)
"""Episodes and rewards of a run with demonstrations, as few as there can be."""

WORDS = (
    "trainer=smoke",
    "trainer.progress_bar=false",
    "trainer.total_frames=256",
    "trainer.checkpoint_interval=64",
    "actor.num_cells=32",
    "critic.num_cells=32",
    "replay.storage.max_size=1024",
    "transforms.time_limit.max_steps=100",
    *BRIEF,
)
LATE = ("matplotlib.pyplot", "morlnav.navigation.audit.report", "morlnav.navigation.record.plots",
        "torch.utils.tensorboard", "torchrl.trainers")  # fmt: skip
"""What a training imports only late; here once, for all copies of this process."""
RESULTS = ("policy.pt", "policy.json", "reward.pt", "reward.json", "clone.pt", "clone.json")


def results(directory: Path) -> list[str]:
    """What two runs of one config have in common: networks, and every table of audit and evaluation."""
    files = [path for folder in ("audit", "evaluation") for path in (directory / folder).glob("*")]
    tables = [path.relative_to(directory).as_posix() for path in files if path.suffix in (".csv", ".json", ".md")]
    return sorted([*RESULTS, *tables])


def differences(ours: Path, theirs: Path) -> list[str]:
    """Files of results that differ or are missing.

    >>> folder = Path(tempfile.mkdtemp())
    >>> differences(folder, folder)[:2]
    ['clone.json', 'clone.pt']
    """
    _, changed, missing = filecmp.cmpfiles(ours, theirs, results(theirs), shallow=False)
    return sorted([*changed, *missing])


def train(directory: Path, cache: Path, resume: bool = False, words: Sequence[str] = WORDS) -> None:
    """A small training in a process of its own; what it prints goes to ``directory``'s name with ``.log``."""
    log = os.open(directory.with_suffix(".log"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(log, stream)
    quiet()
    set_threads(1)
    continued = [f"resume='{directory}'"] if resume else []
    with one_sentence_errors():
        run(composed([*words, f"cache='{cache}'", *continued]), directory)


def in_a_process(call: Callable[[], None]) -> int:
    """Call a function in a copy of this process, and return its number; what is imported already costs nothing."""
    number = os.fork()
    if number:
        return number
    try:
        call()
        os._exit(0)
    except SystemExit as error:
        os.write(2, f"{error.code}\n".encode())
        os._exit(1)
    except BaseException as error:
        os.write(2, f"Traceback: {type(error).__name__}: {error}\n".encode())
        os._exit(3)


def finish(directory: Path, cache: Path) -> str:
    """Go on with a run that was killed, as a user would; what went wrong, or nothing."""
    kept = find_checkpoints(directory)
    number = in_a_process(lambda: train(directory, cache, resume=bool(kept)))
    status = os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])
    said = directory.with_suffix(".log").read_text().strip().splitlines()
    return "" if status == 0 else f"status {status}: {said[-1] if said else 'nothing said'}"


def stage(directory: Path, cache: Path) -> str:
    """How far a run had come when it was killed."""
    if list((directory / "evaluation").glob("*")):
        return "report"
    if (directory / "policy.pt").exists():
        return "evaluation"
    if find_checkpoints(directory):
        return "training after a checkpoint"
    if (directory / "clone.json").exists():
        return "training before a checkpoint"
    kept = {path.name.partition("-")[0] for path in cache.glob("*-*") if path.suffix in ("", ".pt")}
    after = {"audit": "end of the audit", "ranking": "audit", "clone": "ranking", "demonstrations": "clone"}
    begun = "demonstrations" if (directory / "config.yaml").exists() else "start"
    return next((name for made, name in after.items() if made in kept), begun)


def kill_trials(folder: Path, trials: int, seed: int = 0) -> Iterator[dict[str, object]]:
    """Train once undisturbed, then kill and finish a training per trial, at moments spread evenly over its work.

    Args:
        folder: for the runs.
        trials: how many are killed.
        seed: of the moments.

    Yields:
        A row per trial: ``second`` of processor time at the kill, which a busy machine does not change, ``stage`` that
        it hit, ``wrong`` (empty if all is well).
    """
    whole = folder / "whole"
    _, status, used = os.wait4(in_a_process(lambda: train(whole, folder / "cache")), 0)
    if status:
        raise ChildProcessError(whole.with_suffix(".log").read_text())
    length, rng = used.ru_utime + used.ru_stime, random.Random(seed)
    for trial in range(trials):
        directory, cache = folder / f"run{trial}", folder / f"cache{trial}"
        number = in_a_process(lambda directory=directory, cache=cache: train(directory, cache))
        second = length * (trial + rng.random()) / trials
        while (times := psutil.Process(number).cpu_times()).user + times.system < second and not _is_over(number):
            time.sleep(0.01)
        os.kill(number, signal.SIGKILL)
        killed = os.WIFSIGNALED(os.waitpid(number, 0)[1])
        row = {"second": round(second, 2), "stage": stage(directory, cache) if killed else "end"}
        wrong = finish(directory, cache)
        row["wrong"] = wrong or ", ".join(differences(directory, whole))
        yield row
        if not row["wrong"]:
            shutil.rmtree(directory, ignore_errors=True)
            shutil.rmtree(cache, ignore_errors=True)


def _is_over(number: int) -> bool:
    """Whether a process has ended, of its own accord, and waits to be asked for its status."""
    return psutil.Process(number).status() == psutil.STATUS_ZOMBIE


def main() -> None:
    """Entry point; the exit status is 1 if a run did not go on to the same result."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description=__doc__.split("\n", 1)[0])
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, help="a JSON file of the trials so far")
    args = parser.parse_args()
    torch.set_num_threads(1)
    for name in LATE:
        import_module(name)
    folder = Path(tempfile.mkdtemp(prefix="kills"))
    rows = []
    for row in kill_trials(folder, args.trials, args.seed):
        rows.append(row)
        print(f"{row['second']:6.1f} s  {row['stage']:30s} {row['wrong'] or 'the same, bit for bit'}", flush=True)
        if args.output is not None:
            args.output.write_text(json.dumps(rows, indent=2) + "\n")
    wrong = [row for row in rows if row["wrong"]]
    print(f"{len(rows) - len(wrong)} of {len(rows)} went on to the same result{f'; see {folder}' if wrong else ''}.")
    if not wrong:
        shutil.rmtree(folder)
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
