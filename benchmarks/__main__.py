"""``python -m benchmarks``: measure morlnav side by side with its peers and with the machine's limit."""

from __future__ import annotations

import argparse
import platform
from dataclasses import replace
from pathlib import Path

import torch

from benchmarks import growth, learner, memory, quality, simulation, table, training
from benchmarks.timing import Effort, Row
from morlnav.cli import keep_freed_memory, one_sentence_errors, quiet, set_threads
from morlnav.runs import load_config

GROUPS = {"simulation": simulation, "learner": learner, "training": training, "growth": growth, "memory": memory}
"""Groups of rows, each a module with ``TITLE``, ``NOTES`` and ``measure``."""


def run(effort: Effort, groups: list[str], runs: list[Path], devices: list[str], directory: Path) -> str:
    """Measure the groups on every device, write the results into ``directory``, and return the table.

    Args:
        effort: how long to measure.
        groups: names from :data:`GROUPS`.
        runs: run directories whose time to the quality bar is read from their logs.
        devices: where to measure; one that is not there becomes a row that says so.
        directory: where table and plot go.
    """
    rows: list[Row] = []
    for name in groups:
        for device in devices:
            rows += _measure(name, replace(effort, device=device))
    rows += quality.measure(runs)
    headings = {name: (module.TITLE, module.NOTES) for name, module in {**GROUPS, "quality": quality}.items()}
    return table.write(rows, directory, headings, _machine())


def _measure(name: str, effort: Effort) -> list[Row]:
    on_cpu = torch.device(effort.device).type == "cpu"
    if not on_cpu and not torch.cuda.is_available():
        return [Row(name, effort.device, "morlnav", "", note=f"not measured: no {effort.device} device here")]
    print(f"{name} on {effort.device} …", flush=True)
    rows = GROUPS[name].measure(effort)
    return rows if on_cpu else [replace(row, case=f"{row.case}, {effort.device}") for row in rows]


def _machine() -> str:
    gpu = f", {torch.cuda.get_device_name()}" if torch.cuda.is_available() else ""
    threads = torch.get_num_threads()
    return f"Measured with {threads} thread{'s' * (threads > 1)} of {_processor()}{gpu}, PyTorch {torch.__version__}."


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def check(groups: list[str], devices: list[str], runs: list[Path]) -> None:
    """Refuse what could not be measured, before anything is.

    Raises:
        ValueError: for a group or a device that there is not.
        FileNotFoundError: for a run directory that is none.
    """
    unknown = [name for name in groups if name not in GROUPS]
    if unknown:
        raise ValueError(f"There is no group {', '.join(unknown)}; choose from: {', '.join(GROUPS)}.")
    for name in devices:
        try:
            torch.device(name)
        except RuntimeError as error:
            raise ValueError(f"There is no device {name}; such are cpu and cuda.") from error
    for run in runs:
        load_config(run)


def main(words: list[str] | None = None) -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.split(": ", 1)[1])
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"what to measure: {', '.join(GROUPS)}; default all")
    parser.add_argument("--batches", type=int, nargs="+", default=Effort.batches, help="numbers of environments")
    parser.add_argument("--rounds", type=int, default=Effort.rounds, help="turns of every contender")
    parser.add_argument("--seconds", type=float, default=Effort.seconds, help="least duration of a turn")
    parser.add_argument("--threads", type=int, help=f"of PyTorch; default {torch.get_num_threads()}, with --quick 1")
    parser.add_argument("--device", nargs="+", default=["cpu", "cuda"], help="where to measure")
    parser.add_argument("--runs", type=Path, nargs="*", default=[], help="run directories to time to the quality bar")
    parser.add_argument("--output", type=Path, default=Path("results/benchmarks"), help="where table and plot go")
    parser.add_argument("--quick", action="store_true", help="tiny sizes, to try the benchmark itself")
    args = parser.parse_args(words)
    with one_sentence_errors():
        effort = Effort(args.rounds, args.seconds, batches=args.batches)
        check(args.groups, args.device, args.runs)
        default = 1 if args.quick else torch.get_num_threads()
        set_threads(default if args.threads is None else args.threads)
        keep_freed_memory()
        if args.quick:
            effort = Effort(rounds=2, seconds=0.02, batches=(1, 3), quick=True)
        print(run(effort, args.groups or list(GROUPS), args.runs, args.device, args.output))
        print(f"Table and plot are in {args.output}")


if __name__ == "__main__":
    main()
