"""Folders that may not be written to, files that may not be read, and a disk that is full: one sentence each."""

import ctypes
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from drives import TRUTH

from morlnav.navigation.demonstrations import record_demonstrations, save_demonstrations
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import SceneSampler

RUN = Path(__file__).parents[2] / "results" / "two_styles" / "seed_0"
CHILD = """
import contextlib, importlib, io, json, sys
for name, *words in json.loads(sys.argv[1]):
    module = importlib.import_module("morlnav.deployment.export" if name == "export" else f"morlnav.commands.{name}")
    sys.argv, said = [f"morlnav-{name}", *words], io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            module.main()
        print(json.dumps("done"))
    except SystemExit as end:
        print(json.dumps(end.code if isinstance(end.code, str) else said.getvalue().splitlines()[-1]))
"""

LOCKED = {
    "record locked/new --import drive.csv": "locked may not be written to; name another folder for results",
    "record rec --import drive.csv": "rec may not be written to",
    "record new --import secret.csv": "secret.csv: permission denied.",
    "record new --import secrets/drive.csv": "permission denied.",
    "export run --format pt2": "run may not be written to",
    "export run --format pt2 --output locked/new": "locked may not be written to",
    "compare run locked/new --pairs 2 --scenes 2": "locked may not be written to",
    "evaluate run --contexts secret.csv --route 0:hall --output new": "secret.csv: permission denied.",
}
FULL = {
    "record small/new --import drive.csv": "MB free, but",
    "export run --format pt2 --output small/new": "MB free, but",
    "compare run small/other --pairs 2 --scenes 2": "MB free, but",
}


@pytest.fixture
def place(tmp_path):
    """A run, a recording and a drive."""
    (tmp_path / "run").mkdir()
    for name in ("config.yaml", "policy.pt", "policy.json"):
        shutil.copy(RUN / name, tmp_path / "run" / name)
    for name in ("drive.csv", "secret.csv"):
        TRUTH.to_csv(tmp_path / name, index=False)
    for name in ("locked", "secrets", "small"):
        (tmp_path / name).mkdir()
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 1, num_envs=4)
    save_demonstrations(data, tmp_path / "rec")
    return tmp_path


def said(commands, place, **how):
    """What each command says, all in one process."""
    words = [CHILD, json.dumps([command.split() for command in commands])]
    done = subprocess.run([sys.executable, "-c", *words], cwd=place, capture_output=True, text=True, **how)
    assert done.returncode == 0, done.stderr[-2000:]
    return [json.loads(line) for line in done.stdout.splitlines()]


def as_others_do():
    """Without what lets root read and write everything (CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH)."""
    for capability in (1, 2):
        ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)


@pytest.mark.skipif(sys.platform != "linux", reason="root is stripped of its rights in Linux's way")
def test_what_may_not_be_read_or_written_is_named(place):
    modes = {"secret.csv": 0, "secrets": 0, "locked": 0o555, "rec": 0o555, "run": 0o555}
    before = sorted(place.rglob("*"))
    for name, mode in modes.items():
        (place / name).chmod(mode)
    try:
        answers = said(LOCKED, place, preexec_fn=as_others_do)
    finally:
        for name in modes:
            (place / name).chmod(0o755)
    for (command, words), answer in zip(LOCKED.items(), answers, strict=True):
        assert words in answer, f"{command}: {answer}"
        assert "\n" not in answer
    assert sorted(place.rglob("*")) == before


@pytest.mark.skipif(sys.platform != "linux" or os.getuid() != 0, reason="only root mounts a small disk")
def test_a_full_disk_is_named_and_nothing_is_left_half(place):
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", place / "small"], check=False)
    if mounted.returncode:
        pytest.skip("mounting is not allowed here")
    try:
        answers = said(FULL, place)
        left = [path for path in (place / "small").rglob("*") if path.is_file()]
    finally:
        subprocess.run(["umount", place / "small"], check=True)
    for (command, words), answer in zip(FULL.items(), answers, strict=True):
        assert words in answer, f"{command}: {answer}"
        assert "\n" not in answer
    assert not left
