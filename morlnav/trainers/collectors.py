"""Collectors: one in this process, or workers with a share of the environments each."""

from __future__ import annotations

import multiprocessing
import signal
import traceback
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from tensordict.nn import TensorDictModule
from torchrl.collectors import BaseCollector
from torchrl.envs import EnvBase

from morlnav.config import ConfigError, Part, causes, supply, takes


def num_workers(collector: Part[BaseCollector] | Callable[..., BaseCollector]) -> int:
    """How many workers a collector has; 0 for one that collects in this process.

    >>> num_workers(Part({"_target_": "torchrl.collectors.Collector", "num_collectors": 2}, "collector"))
    2
    """
    settings = collector.node if isinstance(collector, Part) else getattr(collector, "keywords", {})
    if "total_frames" in settings:
        raise ValueError("collector.total_frames is trainer.total_frames; collectors are endless.")
    number = settings.get("num_collectors")
    if number is not None and number < 1:
        raise ValueError(f"collector.num_collectors must be at least 1, got {number}.")
    return number or 0


def make_collector(
    collector: Part[BaseCollector] | Callable[..., BaseCollector],
    make_env: Callable[..., EnvBase],
    policy: TensorDictModule,
    *,
    env: EnvBase,
    seed: int,
    device: str,
) -> BaseCollector:
    """The collector of a training, endless; workers make their own share of the environments.

    Args:
        collector: names ``frames_per_batch`` and whatever else TorchRL's collectors take.
        make_env: called as ``make_env(num_envs=..., seed=..., first=...)``; ``first`` counts the environments of the
            workers before.
        policy: what drives.
        env: the environment of a collector without workers; it tells how many there are side by side.
        seed: of the training; workers draw seeds of their own from it.
        device: where policy and environments are.

    Raises:
        ValueError: if the numbers do not divide.
        ChildProcessError: if a worker dies at its start.
    """
    live = {"policy": policy, "total_frames": -1, "device": device}
    workers = num_workers(collector)
    if not workers:
        if "auto_register_policy_transforms" in takes(collector):
            live["auto_register_policy_transforms"] = False
        return supply(collector, create_env_fn=env, **live)
    share = share_of(workers, env.batch_size.numel())
    makers = [partial(_make_workers_env, make_env, share, worker, seed * workers + worker) for worker in range(workers)]
    try:
        return supply(collector, create_env_fn=makers, **live)
    except (RuntimeError, ConfigError) as error:
        if not isinstance(causes(error)[-1], EOFError):
            raise
        for cause in causes(error):  # what is left of the collector, in one of their frames, would hang at exit
            traceback.clear_frames(cause.__traceback__)
        message = "A collecting process died at its start; for lack of memory? Then lower collector.num_collectors."
        raise ChildProcessError(message) from error


def share_of(workers: int, num_envs: int) -> int:
    """How many environments each worker drives.

    Raises:
        ValueError: unless all drive as many.
    """
    if num_envs % workers:
        raise ValueError(f"env.num_envs ({num_envs}) must be a multiple of {workers} collectors.")
    return num_envs // workers


def _make_workers_env(make_env: Callable[..., EnvBase], share: int, worker: int, seed: int) -> Any:
    if multiprocessing.parent_process() is not None:  # Ctrl-C reaches all processes; the learner stops the workers
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)
    torch.manual_seed(seed)  # preferences and exploration draw from the worker's global state
    return make_env(num_envs=share, seed=seed, first=worker * share)
