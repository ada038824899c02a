"""The studies of Fig. 2, small."""

import sys

import pandas as pd
import pytest
from support import DEMONSTRATED, configure

from morlnav.commands import clone
from morlnav.runs import make_training

TINY = ["trainer=smoke", "threads=1", "trainer.progress_bar=false"]


def test_the_clone_is_measured_under_noise_and_against_the_demonstrator(tmp_path):
    words = ["rewards.clone.fit.steps=300", "rewards.num=30", "rewards.clone.actor.num_cells=64"]
    training = make_training(configure(DEMONSTRATED, f"cache={tmp_path}", *words))
    table = clone.Studies(training, episodes=6).noise(levels=(0.0, 1.0))
    assert table["epsilon"].tolist() == [0.0, 1.0]
    assert table["baseline"][0] > table["baseline"][1] + 0.2
    assert (table["demonstrator"] > 0.9).all()  # all of its scenes are free
    assert (table["baseline_low"] <= table["baseline"]).all()


def test_one_command_makes_the_figure_over_the_number_of_demonstrations(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(clone.Studies.number, "__defaults__", ((1, 4),))
    words = ["morlnav-clone", "number", *TINY, "--episodes", "2", f"cache={tmp_path / 'cache'}"]
    monkeypatch.setattr(sys, "argv", [*words, "--output", str(tmp_path / "out")])
    clone.main()
    assert pd.read_csv(tmp_path / "out" / "number.csv")["demonstrations"].tolist() == [1, 4]
    assert (tmp_path / "out" / "number.png").stat().st_size > 1000
    assert "Table and figure are in" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        ("rewards.clone.nonsense=1", r"There is no nonsense in rewards\.clone"),
        ("+rewards.clone.nonsense=1", r"rewards\.clone\.nonsense is no argument of morlnav\.trainers\.Cloning"),
        ("objectives=[baseline,distance]", "nobody can be asked here"),
    ],
)
def test_a_wrong_word_ends_in_one_sentence(word, sentence, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["morlnav-clone", "noise", word])
    with pytest.raises(SystemExit, match=sentence):
        clone.main()
