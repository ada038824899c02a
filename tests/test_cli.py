"""What all commands do with their output, whoever reads it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from morlnav.cli import one_sentence_errors
from morlnav.files import write_tensors

COMMAND = """
from morlnav.cli import one_sentence_errors, quiet
quiet()
with one_sentence_errors():
    print("Fréchet, λ and ŵ")
    {last}
"""


def start(last="pass", **environment):
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND.format(last=last)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | environment,
    )


@pytest.mark.parametrize("encoding", ["latin-1", "ascii"])
def test_what_a_terminal_cannot_show_is_replaced(encoding):
    out, err = (process := start(PYTHONIOENCODING=encoding)).communicate()
    assert process.returncode == 0, err
    assert out.decode(encoding).endswith("? and ?\n".replace("\n", os.linesep))


@pytest.mark.parametrize("last", ["pass", "print('more\\n' * 10**5)", "raise SystemExit(0)"])
def test_a_reader_that_leaves_ends_a_command_without_a_word(last):
    process = start(last)
    process.stdout.close()
    assert process.stderr.read() == b""
    process.wait()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a file that is on a full disk")
def test_a_full_disk_is_named_and_what_to_do():
    sentence = "no space left on device; make room, and start the command again"
    with pytest.raises(SystemExit, match=sentence), one_sentence_errors():
        Path("/dev/full").write_text("more")


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(SystemExit, match=rf"^{tmp_path}: is a directory\.$"), one_sentence_errors():
        tmp_path.read_text()


def test_what_a_disk_cannot_hold_is_not_begun(tmp_path):
    much = torch.zeros(1).expand(10**15)
    with pytest.raises(OSError, match=r"MB free, but 40000000\d+\.\d MB are needed; make room and begin again"):
        write_tensors(TensorDict(reward=much, batch_size=[10**15]), tmp_path / "data")
    assert not list(tmp_path.iterdir())


def test_another_broken_pipe_is_not_kept_silent():
    _, err = (process := start("raise BrokenPipeError('a worker died')")).communicate()
    assert process.returncode == 1
    assert b"a worker died" in err
