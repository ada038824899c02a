"""People compare roll-outs on a page, and a reward learns what they said."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from support import DEMONSTRATED, configure

from morlnav.commands.compare import main
from morlnav.data import read_comparisons
from morlnav.navigation.comparisons import RecordedComparisons, draw_pairs
from morlnav.navigation.demonstrations import demonstration_settings, load_demonstrations
from morlnav.navigation.world import Lidar, TensorWorld
from morlnav.runs import make_training

RUN = Path(__file__).parents[2] / "results" / "two_styles" / "seed_0"
SCENES, STYLES = 4, 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What ``morlnav-compare`` makes, without answers."""
    folder = tmp_path_factory.mktemp("compared") / "mine"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["morlnav-compare", str(RUN), str(folder), "--pairs", "12", "--scenes", str(SCENES)])
        main()
    return folder


@pytest.fixture
def answered(folder, tmp_path):
    """Answers of somebody who likes distance to the human, or, if not ``far``, the opposite."""

    def answer(far=True):
        shutil.copytree(folder, tmp_path / "mine", dirs_exist_ok=True)
        data, pairs = load_demonstrations(folder), content(folder)["pairs"]
        nearest = closest(data)
        lines = [
            {"first": a, "second": b, "preferred": "first" if (nearest[a] > nearest[b]) == far else "second"}
            for a, b in pairs
        ]
        (tmp_path / "mine" / "comparisons.jsonl").write_text("\n".join(map(json.dumps, lines)))
        return tmp_path / "mine"

    return answer


def closest(data):
    """The least distance to the human in each episode."""
    return [data["observation"][data["episode"] == number, 2].min().item() for number in range(SCENES * STYLES)]


def content(folder):
    text = (folder / "compare.html").read_text()
    return json.loads(text.split('id="content">')[1].split("</script>")[0])


def test_roll_outs_are_recorded_in_every_style(folder):
    data, settings = load_demonstrations(folder), demonstration_settings(folder)
    assert data["episode"].unique().tolist() == list(range(SCENES * STYLES))
    assert settings["preferences"] == [[1, 0], [0.5, 0.5], [0, 1]]
    goals = [data["scene", "goal"][data["episode"] == number][0] for number in range(SCENES * STYLES)]
    for number, goal in enumerate(goals):
        assert torch.equal(goal, goals[number % SCENES])
    nearest = torch.tensor(closest(data)).view(STYLES, SCENES)
    assert (nearest[0] > nearest[2]).all()


def test_pairs_are_of_one_scene_and_two_styles():
    pairs = draw_pairs(SCENES, STYLES, 12)
    assert len({frozenset(pair) for pair in pairs}) == 12
    assert all(a != b and a % SCENES == b % SCENES for a, b in pairs)
    assert 0 < sum(a < b for a, b in pairs) < 12  # neither side has the same style always
    with pytest.raises(ValueError, match="3 preferences in 4 scenes make 1 to 12 pairs, got 13"):
        draw_pairs(SCENES, STYLES, 13)


def test_the_page_shows_what_was_driven_and_fetches_nothing(folder):
    data, page = load_demonstrations(folder), content(folder)
    first = page["episodes"][str(page["pairs"][0][0])]
    driven = data["pose"][data["episode"] == page["pairs"][0][0]]
    torch.testing.assert_close(torch.tensor(first["path"][:-1]), driven, rtol=0, atol=1e-3)
    text = (folder / "compare.html").read_text()
    assert not [word for word in ("http", "src=", "href=", "@import", "{CONTENT}") if word in text]


@pytest.mark.skipif(shutil.which("node") is None, reason="the page's script runs in Node, where there is one")
def test_the_page_saves_what_was_answered(folder, tmp_path):
    keys = ["ArrowLeft", "ArrowDown", "Backspace", "ArrowRight", "q", " ", "ArrowDown"]
    words = ["node", Path(__file__).with_name("answer_page.js"), folder / "compare.html", *keys]
    result = json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
    assert result["drawn"] > 100
    assert result["unsaved"]
    assert result["count"] == "Pair 4 of 12"
    (tmp_path / "comparisons.jsonl").write_text(result["saved"])
    answers = read_comparisons(tmp_path / "comparisons.jsonl")
    assert [row.preferred for row in answers] == ["first", "second", "tie"]
    assert [[row.first.episode, row.second.episode] for row in answers] == content(folder)["pairs"][:3]


@pytest.fixture(scope="module")
def learn(tmp_path_factory):
    """What the objective ``demo`` pays after learning from a folder; demonstrations and clone are made once."""
    cache = tmp_path_factory.mktemp("cache")

    def learned(folder, *words):
        words = [f"comparisons.path={folder}", "members=[[observation]]", "reduce=mean", *words]
        small = ["rewards.num=2", "rewards.audit=null", f"cache={cache}", "ranking=compared"]
        cfg = configure(DEMONSTRATED, *small, *(f"rewards.ranking.{word}" for word in words))
        return make_training(cfg).learn_rewards()["demo"].transform

    return learned


@pytest.mark.parametrize("far", [True, False])
def test_a_reward_learns_what_they_said(answered, learn, far):
    folder = answered(far)
    reward = learn(folder, "comparisons.share=1.0", "fit={steps:100,lr:0.01,interval:50}")
    data = load_demonstrations(folder)
    paid = reward.reward(data["observation"], data["action"])
    means = [paid[data["episode"] % SCENES + SCENES * style == data["episode"]].mean() for style in (0, 2)]
    assert (means[0] > means[1]) == far


def test_noise_and_people_teach_one_reward(answered, learn):
    reward = learn(answered(), "comparisons.batch_size=2", "snippet=3")
    assert reward.reward(torch.rand(5, 34), torch.rand(5, 2)).isfinite().all()


def test_other_answers_are_another_reward_in_the_cache(answered, tmp_path):
    def origin(*words):
        cfg = configure(DEMONSTRATED, f"cache={tmp_path}", *words)
        return make_training(cfg).pipeline().stages["demo"].origin("ranking")

    compared = ["ranking=compared", f"rewards.ranking.comparisons.path={answered()}"]
    one, again, none = origin(*compared), origin(*compared), origin()
    answered(far=False)
    assert one == again
    assert len({one, none, origin(*compared)}) == 3


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda file: file.unlink(), r"no file of comparisons .*comparisons\.jsonl"),
        (lambda file: file.write_text('{"first": 0, "second": 99, "preferred": "tie"}'), "no episode 99; they count"),
        (lambda file: file.write_text("{}"), r"comparisons\.jsonl, line 1 must have first, second, preferred"),
    ],
)
def test_answers_that_do_not_fit_are_refused_before_anything_is_learned(answered, change, sentence):
    folder = answered()
    change(folder / "comparisons.jsonl")
    cfg = configure(DEMONSTRATED, "ranking=compared", f"rewards.ranking.comparisons.path={folder}")
    with pytest.raises((ValueError, FileNotFoundError), match=sentence):
        make_training(cfg).pipeline()


def test_roll_outs_seen_by_another_lidar_are_refused(answered):
    with pytest.raises(ValueError, match=r"recorded with lidar.sectors=30 \(here 20\)"):
        RecordedComparisons(answered(), world=TensorWorld(lidar=Lidar(sectors=20)))
