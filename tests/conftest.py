"""What several tests share: one thread, one run that is made once, and the command line."""

import os
import signal
import sys

import pytest
import torch
from support import configure

from morlnav.commands.train import main, run

os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")  # as the command line does, before Ray is imported


@pytest.fixture(autouse=True)
def _one_thread():
    torch.set_num_threads(1)


@pytest.fixture(autouse=True, scope="session")
def _signals_are_heard():
    """A shell's background jobs ignore Ctrl-C, and nohup hang-ups; so would these tests, and what they start."""
    heard = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in heard.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="session")
def smoke_run(tmp_path_factory):
    """Directory of a finished ``trainer=smoke`` run. Read it only."""
    directory = tmp_path_factory.mktemp("smoke")
    run(configure(), directory)
    return directory


@pytest.fixture
def train_command(tmp_path, monkeypatch):
    """``morlnav-train WORDS`` in ``tmp_path``, but in this process: to start another one takes seconds."""

    def command(*words):
        monkeypatch.setattr(sys, "argv", ["morlnav-train", *words])
        main()

    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "")  # noted, so that what the command sets does not outlive the test
    monkeypatch.delenv("HYDRA_FULL_ERROR")
    return command
