"""How fast each collector feeds the learner, as a Markdown table; all rows are measured in turns, in one run.

uv run --extra ray python -m benchmarks.collectors --cases tensor:16 tensor:128 tensor:1024 pymunk:16 --repeats 3
"""

from __future__ import annotations

import argparse
import os
import re
from statistics import median
from time import perf_counter

import torch
from tensordict import TensorDictBase
from torchrl.trainers.trainers import Trainer

from benchmarks.recipes import ANALYTICAL, NEVER, composed, trainer_of
from morlnav.cli import keep_freed_memory, one_sentence_errors, quiet
from morlnav.record.markdown import markdown_table

COLLECTORS = {
    "single": ["collector=single"],
    "processes": ["collector=processes"],
    "processes, sync=false": ["collector=processes", "collector.sync=false"],
    "ray": ["collector=ray"],
    "ray, sync=false": ["collector=ray", "collector.sync=false"],
}
PLAIN = (
    ANALYTICAL,
    *("collector.init_random_frames=0", f"trainer.total_frames={NEVER}", f"trainer.log_interval={NEVER}"),
    *(f"hooks.log_episodes.interval={NEVER}", f"hooks.log_optimisation.interval={NEVER}"),
)


class Clock:
    """Counts frames for ``seconds`` after a warm-up, and the time in which the learner waits for them."""

    def __init__(self, seconds: float, warm_up: float) -> None:
        self.seconds, self.warm_up = seconds, warm_up
        self.first = self.start = self.left = None
        self.frames, self.waited, self.elapsed = 0, 0.0, 0.0

    def arrive(self, batch: TensorDictBase) -> None:
        """A batch has come."""
        now = perf_counter()
        self.first = self.first or now
        if self.start is not None:
            self.frames += batch.numel()
            self.waited += now - self.left

    def leave(self) -> bool:
        """The learner is through with it; returns whether it is over."""
        self.left = perf_counter()
        if self.start is None and self.left - self.first > self.warm_up:
            self.start = self.left
        self.elapsed = self.left - (self.start or self.left)
        return self.elapsed > self.seconds

    @property
    def speed(self) -> float:
        """Frames per second."""
        return self.frames / self.elapsed


def make(case: str, collector: str, overrides: list[str]) -> Trainer:
    """The trainer of a row, seeded; as many updates per frame as in the recipe."""
    world, num_envs = case.split(":")
    size = [f"world={world}", f"env.num_envs={num_envs}"]
    cfg = composed(*PLAIN, *COLLECTORS[collector], *size, *overrides)
    updates = cfg.trainer.optim_steps_per_batch * int(num_envs) // cfg.collector.frames_per_batch
    cfg.collector.frames_per_batch, cfg.trainer.optim_steps_per_batch = int(num_envs), max(1, updates)
    torch.set_num_threads(cfg.threads)
    return trainer_of(cfg)


def collect(trainer: Trainer, clock: Clock) -> None:
    """Collect without learning."""
    for batch in trainer.collector:
        clock.arrive(batch)
        if clock.leave():
            break
    trainer.collector.shutdown()


def train(trainer: Trainer, clock: Clock) -> None:
    """Collect and learn."""
    trainer.register_op("batch_process", clock.arrive)
    trainer.register_op("post_steps", lambda: clock.leave() and trainer.request_stop("measured"))
    trainer.train()


def measure(case: str, collector: str, args: argparse.Namespace) -> tuple[float, float, float]:
    """Frames per second of collecting alone and of training, and the share of the latter in which the learner waits."""
    clocks = {collect: Clock(args.seconds, args.warm_up), train: Clock(args.seconds, args.warm_up)}
    for work, clock in clocks.items():
        work(make(case, collector, args.overrides), clock)
    return clocks[collect].speed, clocks[train].speed, clocks[train].waited / clocks[train].elapsed


def main(words: list[str] | None = None) -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.collectors", description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", default=["tensor:16", "tensor:128", "pymunk:16"], metavar="WORLD:ENVS")
    parser.add_argument("--collectors", nargs="+", default=list(COLLECTORS), choices=COLLECTORS)
    parser.add_argument("--seconds", type=float, default=5.0, help="of every measurement")
    parser.add_argument("--warm-up", type=float, default=2.0, help="seconds before it")
    parser.add_argument("--repeats", type=int, default=1, help="rounds over all rows; the table shows medians")
    parser.add_argument("--overrides", nargs="*", default=[], metavar="KEY=VALUE", help="as of morlnav-train")
    args = parser.parse_args(words)
    quiet()
    keep_freed_memory()
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")  # as morlnav-train, before Ray is imported
    with one_sentence_errors():
        print_table(args)


def print_table(args: argparse.Namespace) -> None:
    """Measure all rows in turn.

    Raises:
        ValueError: for numbers with which nothing would be measured.
    """
    if args.repeats < 1 or not args.seconds > 0 or not args.warm_up >= 0:
        raise ValueError(
            f"Needed are repeats >= 1, seconds > 0 and warm-up >= 0, got {args.repeats}, {args.seconds:g} and "
            f"{args.warm_up:g}."
        )
    for case in args.cases:
        if not re.fullmatch(r"\w+:[1-9]\d*", case):
            raise ValueError(f"A case is WORLD:ENVS, such as tensor:16, but {case} is not.")
    rows = [(case, collector) for case in args.cases for collector in args.collectors]
    found = {row: [] for row in rows}
    for _ in range(args.repeats):
        for case, collector in rows:
            found[case, collector].append(measure(case, collector, args))
    print(f"\n{os.cpu_count()} cores, PyTorch {torch.__version__}, medians of {args.repeats} x {args.seconds:g} s\n")
    head = "world", "environments", "collector", "collecting alone, frames/s", "training, frames/s", "learner waits"
    rows = []
    for (case, collector), measured in found.items():
        alone, training, waits = (median(column) for column in zip(*measured, strict=True))
        rows.append((*case.split(":"), collector, f"{alone:,.0f}", f"{training:,.0f}", f"{waits:.0%}"))
    print(markdown_table(head, rows, (":--", "--:", ":--", "--:")))


if __name__ == "__main__":
    main()
