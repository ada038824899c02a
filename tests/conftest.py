"""What several tests share: one thread, and one run that is made once."""

import os

import pytest
import torch
from support import configure

from morlnav.train import run

os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")  # as the command line does, before Ray is imported


@pytest.fixture(autouse=True)
def _one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def smoke_run(tmp_path_factory):
    """Directory of a finished ``trainer=smoke`` run. Read it only."""
    directory = tmp_path_factory.mktemp("smoke")
    run(configure(), directory)
    return directory
