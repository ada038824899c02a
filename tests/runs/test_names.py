"""A run may lie in a directory of any name, and goes on there."""

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from support import SINGLE, SMALL

from morlnav.runs.resuming import quoted, resumed_words

NAMES = [
    "q'uote",
    'double"quote',
    "both'\"",
    "x=1,y=2",
    "a b",
    "back\\slash",
    "end\\",
    "\\'",
    "{x}",
    "[0]",
    "ümlaut",
    "~",
]
TINY = ("trainer.total_frames=32", "evaluation.episodes=1", "evaluation.steps=1", "hooks={evaluate:null}")


@pytest.mark.parametrize("name", NAMES)
def test_hydra_reads_what_was_quoted(name):
    assert OverridesParser.create().parse_override(f"resume={quoted(name)}").value() == name


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("typed", [str, quoted])
def test_a_run_goes_on_in_its_own_directory(name, typed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name / ".hydra").mkdir(parents=True)
    (tmp_path / name / ".hydra" / "overrides.yaml").write_text("- seed=3\n")
    words, trust = resumed_words([f"resume={typed(name)}", "recipe=analytical"])
    assert words == ["seed=3", "recipe=analytical", f"resume={quoted(name)}", f"hydra.run.dir={quoted(name)}"]
    assert not trust


@pytest.mark.parametrize("name", ["q'uote", "a b=1,c\\"])
def test_a_run_is_trained_and_resumed_there(name, train_command, capsys):
    train_command(*SMALL, SINGLE, *TINY, f"hydra.run.dir={quoted(name)}")
    train_command(f"resume={name}", "trainer.total_frames=64")
    assert f"/{name}\n" in capsys.readouterr().out.split("Everything is in ")[2]
