"""Collectors: one in this process, whose episodes can be saved, or watched workers with a share of the environments."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import wait
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.collectors import BaseCollector, Collector
from torchrl.envs import EnvBase, TransformedEnv

from morlnav.config import ConfigError, Part, supply, takes
from morlnav.limits import check_at_least
from morlnav.sentences import causes


def num_workers(collector: Part[BaseCollector] | Callable[..., BaseCollector]) -> int:
    """How many workers a collector has; 0 for one that collects in this process.

    >>> num_workers(Part({"_target_": "torchrl.collectors.Collector", "num_collectors": 2}, "collector"))
    2
    """
    settings = collector.node if isinstance(collector, Part) else getattr(collector, "keywords", {})
    if "total_frames" in settings:
        raise ValueError("collector.total_frames is trainer.total_frames; collectors are endless.")
    number = settings.get("num_collectors")
    check_at_least(1, **{"collector.num_collectors": number})
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


@contextmanager
def watched(collector: BaseCollector) -> Iterator[None]:
    """Raise in the main thread when a worker process of ``collector`` dies; TorchRL would wait for it forever.

    Whatever else is raised shuts the workers down too, or the interpreter would wait for them at exit.
    Collectors without processes of their own are left alone, and so are systems without ``SIGUSR1``.

    Raises:
        ChildProcessError: out of the context; the other workers are shut down first.
    """
    workers = getattr(collector, "procs", ())
    if not workers or not hasattr(signal, "SIGUSR1"):
        yield
        return
    learner, died, over = threading.get_ident(), threading.Event(), threading.Event()

    def interrupt(*_: object) -> None:
        raise ChildProcessError

    def watch() -> None:
        wait([worker.sentinel for worker in workers])
        if not (over.is_set() or collector.closed):
            died.set()
        while not (over.wait(1.0) or collector.closed):  # once may not do: TorchRL catches what interrupts its waiting
            signal.pthread_kill(learner, signal.SIGUSR1)

    before = signal.signal(signal.SIGUSR1, interrupt)
    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    except BaseException as error:  # ours, or what TorchRL says of its half-closed workers, or another
        over.set()
        with suppress(ValueError):  # TorchRL's, about the process that is no more
            collector.shutdown()
        if not died.is_set():
            raise
        message = "A collecting process died; continue from the last checkpoint: resume=RUN_DIR."
        raise ChildProcessError(message) from error
    finally:
        over.set()
        signal.signal(signal.SIGUSR1, before)


class RolloutState:
    """Checkpoint component that holds a collector's unfinished episodes, so that a resumed run equals an unbroken one.

    TorchRL's collector starts new episodes after loading, because environments cannot be saved in general. One that
    can has ``get_state()`` and ``set_state(state)``, as :class:`~morlnav.navigation.envs.NavigationEnv` does.

    Args:
        collector: a single-process collector of such an environment.
    """

    def __init__(self, collector: Collector) -> None:
        self.collector = collector

    @staticmethod
    def can_hold(env: TransformedEnv) -> bool:
        """Whether an environment can be saved; after the others, a resumed run begins new episodes.

        >>> from torchrl.envs import PendulumEnv
        >>> RolloutState.can_hold(TransformedEnv(PendulumEnv()))
        False
        """
        return all(callable(getattr(env.base_env, name, None)) for name in ("get_state", "set_state"))

    def state_dict(self) -> dict[str, Any]:
        """The environment's state, and the tensordict that the next step starts from."""
        return {"env": self.collector.env.base_env.get_state(), "carrier": self.collector._carrier.clone().to_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Put the episodes back where they were."""
        self.collector.env.base_env.set_state(state["env"])
        carrier = self.collector._carrier
        carrier.update(TensorDict(state["carrier"], batch_size=carrier.batch_size))
