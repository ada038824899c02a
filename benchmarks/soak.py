"""Train for hours, and see that memory, speed and what is left behind stay as they should.

``python -m benchmarks.soak --hours 2`` trains without demonstrations in a process of its own, and every few seconds
writes a line of ``soak.csv``, with resident memory, frames, speed and the machine's load, and into ``soak.json`` how
memory and speed went so far. Beside it a short training each is ended by Ctrl-C, by ``SIGTERM`` to its process group
and by the death of a worker; ``soak.json`` tells what each left running and in ``/dev/shm``.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import psutil

WORDS = ("objectives=[baseline,distance,efficiency]", "trainer.progress_bar=false", "trainer.total_frames=1000000000")
LONG = (*WORDS, "replay.storage.max_size=64000")  # full after some minutes, so that what grows later is no transition
SMALL = ("trainer=smoke", *WORDS, "collector=processes")
ENDINGS = ("ctrl-c", "sigterm", "dead worker")
SHARED = Path("/dev/shm")


def start(directory: Path, words: Sequence[str]) -> subprocess.Popen[str]:
    """``morlnav-train`` with these words, as the leader of a process group; what it prints goes to ``train.log``."""
    directory.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "morlnav.commands.train", *words, f"hydra.run.dir='{directory / 'run'}'"]
    with (directory / "train.log").open("w") as log:
        return subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, text=True, start_new_session=True)


def frames(run: Path) -> int:
    """How many frames a run has logged.

    >>> frames(Path("nowhere"))
    0
    """
    logs = list(run.glob("logs/scalars/optim/loss_qvalue.csv"))
    lines = logs[0].read_text().splitlines() if logs else []
    return int(float(lines[-1].split(",")[0])) if lines else 0


def family(process: psutil.Process) -> list[psutil.Process]:
    """A process and all that it has started."""
    return [process, *process.children(recursive=True)]


def memory(process: psutil.Process) -> float:
    """Resident memory of a process and all that it has started, in MB.

    >>> memory(psutil.Process()) > 1
    True
    """
    total = 0
    for member in family(process):
        try:
            total += member.memory_info().rss
        except psutil.NoSuchProcess:
            continue
    return total / 1e6


def shared(process: psutil.Process) -> set[Path]:
    """Files of shared memory that a process or any that it has started holds; not those of other programs."""
    held = set()
    for member in family(process):
        with contextlib.suppress(psutil.Error, OSError):
            held |= {Path(part.path) for part in member.memory_maps()}
    return {path for path in held if path.parent == SHARED}


def soak(
    directory: Path, hours: float, interval: float = 10.0, words: Sequence[str] = LONG
) -> Iterator[dict[str, float]]:
    """Train for some hours, or until nobody asks for more looks, and end it by Ctrl-C.

    Args:
        directory: receives the run.
        hours: how long.
        interval: seconds between two looks.
        words: of the training.

    Yields:
        A row per look: ``second``, ``rss`` (MB), ``frames``, ``speed`` (frames/s since the last look) and ``load``, the
        processes that wanted a core of the machine in the last minute, with those of others.

    Raises:
        ChildProcessError: if the training ends by itself.
    """
    training, began = start(directory, words), time.monotonic()
    process, last = psutil.Process(training.pid), (0.0, 0)
    try:
        while (second := time.monotonic() - began) < 3600 * hours:
            if training.poll() is not None:
                raise ChildProcessError((directory / "train.log").read_text())
            now = frames(directory / "run")
            speed = (now - last[1]) / (second - last[0]) if second > last[0] else 0.0
            row = {"second": second, "rss": memory(process), "frames": now, "speed": speed}
            yield {name: round(value, 1) for name, value in row.items()} | {"load": round(psutil.getloadavg()[0], 2)}
            last = second, now
            time.sleep(interval)
    finally:
        training.send_signal(signal.SIGINT)
        training.wait(600)


def left_behind(directory: Path, how: str) -> dict[str, object]:
    """End a training with workers in one of three ways, and tell what it leaves.

    Args:
        directory: receives the run.
        how: ``"ctrl-c"``, ``"sigterm"`` to the process group, or ``"dead worker"``.

    Returns:
        ``status`` of the training, ``orphans``, files left in ``shm``, and the ``checkpoint`` it can go on from.
    """
    training, run, seen = start(directory, SMALL), directory / "run", set[Path]()
    process = psutil.Process(training.pid)
    while not list(run.glob("checkpoints/checkpoint-*")):
        if training.poll() is not None:
            raise ChildProcessError((directory / "train.log").read_text())
        seen |= shared(process)
        time.sleep(0.2)
    workers = family(process)[1:]
    if how == "ctrl-c":
        os.killpg(training.pid, signal.SIGINT)
    elif how == "sigterm":
        os.killpg(training.pid, signal.SIGTERM)
    else:
        max(workers, key=lambda worker: worker.memory_info().rss).kill()
    try:
        status = training.wait(600)
    except subprocess.TimeoutExpired:
        os.killpg(training.pid, signal.SIGKILL)
        raise
    _, alive = psutil.wait_procs(workers, timeout=10)
    left = {path.name for path in seen if path.exists()}
    checkpoint = sorted(path.name for path in run.glob("checkpoints/checkpoint-*"))[-1]
    return {"status": status, "orphans": len(alive), "shm": sorted(left), "checkpoint": checkpoint}


def summary(table: pd.DataFrame) -> dict[str, float]:
    """Memory and speed of the last quarter beside those of the second, hours, and the machine's load.

    ``rss_growth`` is that of memory since the first quarter, in MB per hour.

    >>> rows = pd.DataFrame({"second": range(0, 7260, 60), "rss": 900.0, "frames": 0, "speed": 50.0, "load": 1.0})
    >>> summary(rows)["rss_growth"], summary(rows)["speed_last"], summary(rows)["hours"]
    (0.0, 50.0, 2.0)
    """
    quarters = [table.iloc[rows] for rows in np.array_split(np.arange(len(table)), 4)]
    steady = table.iloc[len(table) // 4 :]
    growth = np.polyfit(steady["second"] / 3600, steady["rss"], 1)[0] if len(steady) > 1 else 0.0
    values = {"hours": table["second"].iloc[-1] / 3600, "load": table["load"].mean(), "rss_growth": growth}
    for name in ("rss", "speed"):
        values |= {f"{name}_second": quarters[1][name].mean(), f"{name}_last": quarters[3][name].mean()}
    return {name: round(float(value), 2) + 0.0 for name, value in values.items()}


def main() -> None:
    """Entry point; the exit status is 1 if anything was left behind."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__.split("\n", 1)[0])
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--interval", type=float, default=10.0, help="seconds between two looks (default: 10)")
    parser.add_argument("--output", type=Path, default=Path("outputs/soak"), help="default: outputs/soak")
    args = parser.parse_args()
    if args.hours <= 0 or args.interval <= 0:
        parser.error("--hours and --interval must be positive")
    args.output.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    signal.signal(signal.SIGINT, signal.default_int_handler)  # or trainings would ignore it, too, in the background
    result: dict[str, dict[str, object]] = {}
    rows, endings = [], iter(ENDINGS)
    with contextlib.closing(soak(args.output, args.hours, args.interval)) as looks:
        for row in looks:
            rows.append(row)
            table = pd.DataFrame(rows)
            table.to_csv(args.output / "soak.csv", index=False)
            if (how := next(endings, None)) is not None:
                result[how] = left_behind(args.output / how.replace(" ", "_"), how)
            if len(rows) >= 4:
                result["soak"] = summary(table)
            (args.output / "soak.json").write_text(json.dumps(result, indent=2) + "\n")
    print(json.dumps(result, indent=2))
    missed = [how for how in ENDINGS if how not in result or result[how]["orphans"] or result[how]["shm"]]
    raise SystemExit(bool(missed))


if __name__ == "__main__":
    main()
