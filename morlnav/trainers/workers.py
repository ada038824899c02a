"""Keeping an eye on worker processes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import wait

from torchrl.collectors import BaseCollector


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
