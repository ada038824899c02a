"""Comparisons are read as they were meant, or refused with their line; pairs are drawn as somebody preferred them."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from morlnav.data import ComparedPairs, Comparison, Snippet, read_comparisons
from morlnav.modules import RewardModel
from morlnav.objectives import RankingLoss
from morlnav.trainers import Fit

CSV = "first,second,preferred\n0,1,first\n\n2:3:9, 1 ,tie\n1,0:0:5,second\n"
JSON = '\n{"first": 0, "second": 1, "preferred": "first"}\n{"second": "1", "first": "2:3:9", "preferred": "tie"}\n'
JSON += '{"first": 1, "second": "0:0:5", "preferred": "second"}\n'


def rows(*steps):
    """Episodes of so many steps, whose observations are episode and step."""
    episode = torch.cat([torch.full((count,), number) for number, count in enumerate(steps)])
    step = torch.cat([torch.arange(count) for count in steps])
    return TensorDict(
        observation=torch.stack([episode, step], 1).float(),
        action=torch.zeros(len(step), 1),
        episode=episode,
        batch_size=[len(step)],
    )


def compare(first, second, preferred="first"):
    return Comparison(Snippet(*first), Snippet(*second), preferred)


@pytest.mark.parametrize(("name", "text"), [("a.csv", CSV), ("a.jsonl", JSON), ("a.CSV", "\ufeff" + CSV)])
def test_both_kinds_of_files_say_the_same(tmp_path, name, text):
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert read_comparisons(tmp_path / name) == [
        compare((0,), (1,)),
        compare((2, 3, 9), (1,), "tie"),
        compare((1,), (0, 0, 5), "second"),
    ]


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.csv", "", "holds no comparisons"),
        ("a.jsonl", "\n", "holds no comparisons"),
        ("a.csv", "first,second,preferred\n", "holds no comparisons"),
        (
            "a.csv",
            "first,second\n0,1\n",
            "line 2 must have first, second, preferred and nothing else, got first, second",
        ),
        ("a.csv", "first,second,preferred,rater\n0,1,tie,me\n", "nothing else, got first, second, preferred, rater"),
        ("a.csv", "first,second,preferred\n0,1,tie,\n", "line 2 has 4 fields, its header 3"),
        ("a.csv", "first,second,preferred\n0,1,tie\n0,1\n", "line 3 has 2 fields, its header 3"),
        ("a.jsonl", "[" * 10**5, "line 1 is not readable as JSON"),
        ("a.csv", "first;second;preferred\n0;1;tie\n", "must have first, second, preferred"),
        ("a.csv", "first,second,preferred\n0,1,left\n", "line 2, preferred: expected first, second or tie, got 'left'"),
        ("a.csv", "first,second,preferred\n0,1,\n", "expected first, second or tie, got ''"),
        (
            "a.csv",
            "first,second,preferred\n-1,1,tie\n",
            r"line 2, first: expected the number of an episode, .* got '-1'",
        ),
        ("a.csv", "first,second,preferred\n1.0,2,tie\n", "got '1.0'"),
        ("a.csv", "first,second,preferred\n1,2:4,tie\n", "line 2, second: .* got '2:4'"),
        ("a.csv", "first,second,preferred\n1,1,tie\n", "compares a snippet with itself"),
        ("a.jsonl", '{"first": 0,\n', "line 1 is not readable as JSON"),
        ("a.jsonl", "[0, 1, 2]\n", "nothing else, got list"),
        ("a.jsonl", '{"first": true, "second": 1, "preferred": "tie"}', "got True"),
        ("a.jsonl", '{"first": 0.5, "second": 1, "preferred": "tie"}', "got 0.5"),
        ("a.jsonl", '{"first": null, "second": 1, "preferred": "tie"}', "got None"),
        ("a.jsonl", '{"first": 0, "first": 2, "second": 1, "preferred": "tie"}', "nothing else, got list"),
        ("a.jsonl", '[{"first": 0, "second": 1, "preferred": "tie"}]', "nothing else, got list"),
        ("a.csv", "0,1,first\n1,2,second\n", "line 2 must have first, second, preferred"),
        ("a.csv", "first,second,preferred\n0,1,First\n", "got 'First'"),
        ("a.pkl", "", r"\.csv or \.jsonl files"),
    ],
)
def test_what_does_not_follow_the_schema_is_refused_with_its_line(tmp_path, name, text, sentence):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=sentence) as error:
        read_comparisons(tmp_path / name)
    assert "\n" not in str(error.value)


def test_files_that_are_missing_or_no_text_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no file of comparisons .*a\.csv"):
        read_comparisons(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="no text in UTF-8"):
        read_comparisons(tmp_path / "a.csv")


def test_the_better_one_is_the_preferred_one_in_whichever_place():
    pairs = ComparedPairs([compare((0,), (1,)), compare((1,), (0,), "second")], rows(4, 6), batch_size=64)
    for batch in (pairs.sample(), pairs.held_out):
        assert (batch["better", "observation"][:, 0, 0] == 0).all()
        assert (batch["worse", "observation"][:, 0, 0] == 1).all()


def test_a_tie_comes_in_either_order_and_is_never_held_out():
    decided = [compare((0,), (1,)), compare((0,), (2,))]
    ties = [compare((1, 0, k), (2, 0, k), "tie") for k in range(1, 6)]
    pairs = ComparedPairs([*ties, *decided], rows(4, 6, 6), batch_size=2000)
    assert (pairs.held_out["better", "observation"][:, 0, 0] == 0).all()
    better = pairs.sample()["better", "observation"][:, 0, 0]
    shares = [(better == episode).float().mean().item() for episode in range(3)]
    # One decided comparison and five ties have equal parts; those of a tie are one half each.
    assert shares == pytest.approx([1 / 6, 5 / 12, 5 / 12], abs=0.05)


def test_snippets_are_the_steps_that_were_named():
    pairs = ComparedPairs([compare((1, 2, 5), (0,))] * 2, rows(4, 6), batch_size=1).sample()
    better, worse = pairs["better"][0], pairs["worse"][0]
    assert better["observation"][better["mask"]].tolist() == [[1, 2], [1, 3], [1, 4]]
    assert worse["observation"][worse["mask"]].tolist() == [[0, step] for step in range(4)]


@pytest.mark.parametrize(
    ("comparisons", "settings", "sentence"),
    [
        ([compare((0,), (7,))], {}, "no episode 7; they count from 0 to 1"),
        ([compare((0,), (10**30,))], {}, "no episode 1000"),
        ([compare((0,), (0, 0, 4))], {}, "Episode 0 from step 0 on is compared with itself"),
        ([compare((0,), (1, 2, 9))], {}, "no snippet 1:2:9; episode 1 has 6 steps"),
        ([compare((0,), (1, 3, 3))], {}, "no snippet 1:3:3"),
        ([compare((0,), (1,), "tie")] * 3 + [compare((0,), (1,))], {}, "must be decided, got 1 and 3 ties"),
        ([compare((0,), (1,))] * 2, {"share": 0.0}, "share must be above 0"),
        ([compare((0,), (1,))] * 2, {"share": 1.5}, "share must be above 0 and at most 1, got 1.5"),
        ([compare((0,), (1,))] * 2, {"batch_size": 0}, "batch_size must be at least 1"),
        ([compare((0,), (1,))] * 2, {"held_out": 1.0}, "held_out must be from 0 to below 1"),
    ],
)
def test_comparisons_of_what_is_not_there_are_refused(comparisons, settings, sentence):
    with pytest.raises(ValueError, match=sentence):
        ComparedPairs(comparisons, rows(4, 6), **settings)


def test_held_out_pairs_of_both_sources_weigh_what_their_share_says():
    pairs = ComparedPairs([compare((1,), (0,))] * 5, rows(4, 6), share=0.75, held_out=0.4)
    snippets = TensorDict(observation=torch.full((10, 3, 2), 9.0), action=torch.zeros(10, 3, 1), batch_size=[10])
    snippets["mask"] = torch.ones(10, 3, dtype=torch.bool)
    both = pairs.join(TensorDict(better=snippets, worse=snippets, batch_size=[10]))
    assert len(both) == 40
    assert both["better", "mask"].sum(1).tolist() == [3] * 10 + [6] * 30
    assert pairs.share < 1
    pairs.share = 1
    assert pairs.join(both) is pairs.held_out


def test_a_reward_learns_what_somebody_prefers():
    """Somebody who likes large numbers, but not to the last digit, in episodes of 3 to 12 steps."""
    torch.manual_seed(0)
    steps = [3 + number % 10 for number in range(60)]
    data, liking = rows(*steps), torch.rand(60)
    data["observation"] = torch.stack(
        [liking[data["episode"]] + 0.1 * torch.randn(len(data)), torch.rand(len(data))], 1
    )
    comparisons = []
    for first, second in torch.randint(60, (200, 2)).tolist():
        gap = liking[first] - liking[second]
        if first != second:
            answer = "tie" if abs(gap) < 0.1 else "first" if gap > 0 else "second"
            comparisons.append(compare((first,), (second,), answer))
    pairs = ComparedPairs(comparisons, data, batch_size=32, held_out=0.2)
    model = RewardModel(["observation"], [-1.0], [1.0], features=2, depth=1, num_cells=32)
    loss = RankingLoss(TensorDictModule(model, ["observation", "action"], ["reward"]))
    scores = Fit(steps=300, lr=0.01)(loss, pairs.sample, pairs.held_out)
    assert scores["accuracy"] > 0.9
    likes = [model(torch.tensor([[value, 0.5]])).item() for value in (0.1, 0.5, 0.9)]
    assert likes == sorted(likes)
    assert likes[2] - likes[0] > 0.3
