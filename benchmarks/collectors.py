"""How fast each collector feeds the learner, as a Markdown table; all rows are measured in turns, in one run.

uv run python benchmarks/collectors.py --cases tensor:16 tensor:128 tensor:1024 pymunk:16 --repeats 3
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter

import torch
from hydra import compose, initialize_config_dir
from tensordict import TensorDictBase
from torchrl.trainers.trainers import Trainer

from morlnav.cli import conf_dir, keep_freed_memory, quiet
from morlnav.record.loggers import TensorboardCSVLogger
from morlnav.trainers import make_trainer

COLLECTORS = {
    "single": ["collector=single"],
    "processes": ["collector=processes"],
    "processes, sync=false": ["collector=processes", "collector.sync=false"],
    "ray": ["collector=ray"],
    "ray, sync=false": ["collector=ray", "collector.sync=false"],
}
NEVER = 2**62
PLAIN = (
    "objectives=[baseline,distance,efficiency]",
    *("trainer.random_frames=0", "trainer.progress_bar=false", f"trainer.checkpoint.interval={NEVER}"),
    *(f"trainer.total_frames={NEVER}", f"evaluation.during.interval={NEVER}", f"logger.interval={NEVER}"),
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


def make(case: str, collector: str, overrides: list[str], directory: str) -> Trainer:
    """The trainer of a row, seeded."""
    world, num_envs = case.split(":")
    size = [f"world={world}", f"env.num_envs={num_envs}"]
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        cfg = compose("train", [*PLAIN, *COLLECTORS[collector], *size, *overrides])
    updates = cfg.trainer.optim_steps_per_batch * int(num_envs) // cfg.trainer.frames_per_batch
    cfg.trainer.frames_per_batch, cfg.trainer.optim_steps_per_batch = int(num_envs), max(1, updates)
    torch.set_num_threads(cfg.threads)
    torch.manual_seed(cfg.seed)
    return make_trainer(cfg, Path(directory), TensorboardCSVLogger("logs", Path(directory)))


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
        with TemporaryDirectory() as directory:
            work(make(case, collector, args.overrides, directory), clock)
    return clocks[collect].speed, clocks[train].speed, clocks[train].waited / clocks[train].elapsed


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", default=["tensor:16", "tensor:128", "pymunk:16"], metavar="WORLD:ENVS")
    parser.add_argument("--collectors", nargs="+", default=list(COLLECTORS), choices=COLLECTORS)
    parser.add_argument("--seconds", type=float, default=5.0, help="of every measurement")
    parser.add_argument("--warm-up", type=float, default=2.0, help="seconds before it")
    parser.add_argument("--repeats", type=int, default=1, help="rounds over all rows; the table shows medians")
    parser.add_argument("--overrides", nargs="*", default=[], metavar="KEY=VALUE", help="as of morlnav-train")
    args = parser.parse_args()
    quiet()
    keep_freed_memory()
    rows = [(case, collector) for case in args.cases for collector in args.collectors]
    found = {row: [] for row in rows}
    for _ in range(args.repeats):
        for case, collector in rows:
            found[case, collector].append(measure(case, collector, args))
    print(f"\n{os.cpu_count()} cores, PyTorch {torch.__version__}, medians of {args.repeats} x {args.seconds:g} s\n")
    print("| world | environments | collector | collecting alone, frames/s | training, frames/s | learner waits |")
    print("| :-- | --: | :-- | --: | --: | --: |")
    for (case, collector), measured in found.items():
        alone, training, waits = (median(column) for column in zip(*measured, strict=True))
        cells = (*case.split(":"), collector, f"{alone:,.0f}", f"{training:,.0f}", f"{waits:.0%}")
        print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
