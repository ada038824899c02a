"""What all commands do with their output, whoever reads it."""

import os
import subprocess
import sys

import pytest

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


def test_another_broken_pipe_is_not_kept_silent():
    _, err = (process := start("raise BrokenPipeError('a worker died')")).communicate()
    assert process.returncode == 1
    assert b"a worker died" in err
