"""Train for hours, and see that memory, speed and what is left behind stay as they should.

``python -m benchmarks.soak --hours 2`` trains without demonstrations in a process of its own, and writes a line of
``soak.csv`` every few seconds: resident memory, frames and speed. Then a short training each is ended by Ctrl-C, by
``SIGTERM`` to its process group and by the death of a worker; ``soak.json`` tells what each left running and in
``/dev/shm``, and how memory and speed went.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import psutil

WORDS = ("objectives=[baseline,distance,efficiency]", "trainer.progress_bar=false", "trainer.total_frames=1000000000")
SMALL = ("trainer=smoke", *WORDS, "collector=processes")
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
    logs = list(run.glob("logs/scalars/loss_qvalue.csv"))
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


def soak(directory: Path, hours: float, interval: float = 10.0, words: Sequence[str] = WORDS) -> pd.DataFrame:
    """Train for some hours, end it by Ctrl-C, and return a row per look at it.

    Args:
        directory: receives ``soak.csv`` and the run.
        hours: how long.
        interval: seconds between two looks.
        words: of the training.

    Returns:
        Columns ``second``, ``rss`` (MB), ``frames`` and ``speed`` (frames/s since the last look).

    Raises:
        ChildProcessError: if the training ends by itself.
    """
    training, began = start(directory, words), time.monotonic()
    process, last = psutil.Process(training.pid), (0.0, 0)
    with (directory / "soak.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["second", "rss", "frames", "speed"])
        while (second := time.monotonic() - began) < 3600 * hours:
            if training.poll() is not None:
                raise ChildProcessError((directory / "train.log").read_text())
            now = frames(directory / "run")
            speed = (now - last[1]) / (second - last[0]) if second > last[0] else 0.0
            table.writerow([round(second, 1), round(memory(process), 1), now, round(speed, 1)])
            file.flush()
            last = second, now
            time.sleep(interval)
    training.send_signal(signal.SIGINT)
    training.wait(600)
    return pd.read_csv(directory / "soak.csv")


def left_behind(directory: Path, how: str) -> dict[str, object]:
    """End a training with workers in one of three ways, and tell what it leaves.

    Args:
        directory: receives the run.
        how: ``"ctrl-c"``, ``"sigterm"`` to the process group, or ``"dead worker"``.

    Returns:
        ``status`` of the training, ``orphans``, files left in ``shm``, and the ``checkpoint`` it can go on from.
    """
    before = set(SHARED.glob("*")) if SHARED.is_dir() else set()
    training, run = start(directory, SMALL), directory / "run"
    while not list(run.glob("checkpoints/checkpoint-*")):
        if training.poll() is not None:
            raise ChildProcessError((directory / "train.log").read_text())
        time.sleep(0.2)
    workers = family(psutil.Process(training.pid))[1:]
    if how == "ctrl-c":
        os.killpg(training.pid, signal.SIGINT)
    elif how == "sigterm":
        os.killpg(training.pid, signal.SIGTERM)
    else:
        max(workers, key=lambda worker: worker.memory_info().rss).kill()
    status = training.wait(300)
    _, alive = psutil.wait_procs(workers, timeout=10)
    left = {path.name for path in SHARED.glob("*") if path not in before and _is_ours(path)}
    checkpoint = sorted(path.name for path in run.glob("checkpoints/checkpoint-*"))[-1]
    return {"status": status, "orphans": len(alive), "shm": sorted(left), "checkpoint": checkpoint}


def _is_ours(path: Path) -> bool:
    """Whether nobody else holds a file of shared memory open; other programs may have made it meanwhile."""
    held = set()
    for process in psutil.process_iter():
        try:
            held |= {name.path for name in process.memory_maps()}
        except (psutil.Error, OSError):
            continue
    return path.exists() and str(path) not in held


def summary(table: pd.DataFrame) -> dict[str, float]:
    """Memory and speed of the last quarter beside those of the second, and the growth of memory in MB per hour.

    >>> rows = pd.DataFrame({"second": range(0, 7200, 60), "rss": 900.0, "frames": 0, "speed": 50.0})
    >>> summary(rows)["rss_growth"], summary(rows)["speed_last"]
    (0.0, 50.0)
    """
    quarters = [table.iloc[rows] for rows in np.array_split(np.arange(len(table)), 4)]
    steady = table.iloc[len(table) // 4 :]
    growth = np.polyfit(steady["second"] / 3600, steady["rss"], 1)[0] if len(steady) > 1 else 0.0
    return {
        "rss_second": float(quarters[1]["rss"].mean()),
        "rss_last": float(quarters[3]["rss"].mean()),
        "rss_growth": round(float(growth), 1) + 0.0,
        "speed_second": float(quarters[1]["speed"].mean()),
        "speed_last": float(quarters[3]["speed"].mean()),
    }


def main() -> None:
    """Entry point; the exit status is 1 if anything was left behind."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__.split("\n", 1)[0])
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--interval", type=float, default=10.0, help="seconds between two looks (default: 10)")
    parser.add_argument("--output", type=Path, default=Path("outputs/soak"), help="default: outputs/soak")
    args = parser.parse_args()
    if args.hours < 0 or args.interval <= 0:
        parser.error("--hours must not be negative, and --interval positive")
    args.output.mkdir(parents=True, exist_ok=True)
    result = {"soak": summary(soak(args.output, args.hours, args.interval))} if args.hours else {}
    for how in ("ctrl-c", "sigterm", "dead worker"):
        result[how] = left_behind(args.output / how.replace(" ", "_"), how)
    (args.output / "soak.json").write_text(json.dumps(result, indent=2))
    print(json.dumps(result, indent=2))
    raise SystemExit(any(result[how]["orphans"] or result[how]["shm"] for how in ("ctrl-c", "sigterm", "dead worker")))


if __name__ == "__main__":
    main()
