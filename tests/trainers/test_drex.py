import json

import pytest
import torch
from support import BRIEF, configure, trainer_for

from morlnav import load
from morlnav.commands.evaluate import main as evaluate_main
from morlnav.commands.train import run
from morlnav.modules import load_reward, read_facts
from morlnav.trainers.drex import make_demonstrations

SMALL = [*BRIEF, "objectives=[baseline,demo,distance,efficiency]"]


@pytest.fixture(scope="module")
def demonstration_run(tmp_path_factory):
    directory = tmp_path_factory.mktemp("demonstrations")
    cfg = configure(*SMALL, f"cache={directory / 'cache'}")
    run(cfg, directory / "run")
    return cfg, directory


def test_demonstrations_become_the_first_tuneable_objective(demonstration_run):
    _, directory = demonstration_run
    policy = load(directory / "run")
    assert policy.objectives == ("demo", "distance", "efficiency")
    assert policy(torch.zeros(34), torch.tensor([1.0, 0.0, 0.0])).shape == (2,)


def test_the_run_keeps_its_reward_model_and_needs_nothing_else(demonstration_run, tmp_path, monkeypatch, capsys):
    _, directory = demonstration_run
    assert "held_out" in read_facts(directory / "run" / "reward.pt")["facts"]
    moved = (directory / "run").rename(tmp_path / "moved")
    hidden = (directory / "cache").rename(tmp_path / "hidden")
    monkeypatch.chdir(tmp_path)
    settings = ("--episodes=1", "--steps=1", "--threads=1", "--output=again")
    monkeypatch.setattr("sys.argv", ["morlnav-evaluate", "moved", *settings])
    try:
        assert load("moved").objectives[0] == "demo"
        evaluate_main()
    finally:
        moved.rename(directory / "run")
        hidden.rename(directory / "cache")
    shown = capsys.readouterr().out
    assert "Fréchet m" in shown
    assert "Audit of demo: " in shown
    assert (tmp_path / "again" / "table.md").is_file()


def test_every_stage_is_cached_by_its_config(demonstration_run):
    _, directory = demonstration_run
    stages = {path.name.partition("-")[0] for path in (directory / "cache").iterdir()}
    assert stages == {"demonstrations", "clone", "ranking", "audit"}


def test_the_report_measures_the_distance_to_the_demonstration(demonstration_run):
    _, directory = demonstration_run
    assert "frechet" in (directory / "run" / "evaluation" / "episodes.csv").read_text().splitlines()[0]


def test_the_run_keeps_the_audit_of_its_reward(demonstration_run):
    _, directory = demonstration_run
    verdict = json.loads((directory / "run" / "audit" / "audit.json").read_text())
    assert not verdict["passed"]  # nothing is learned in five updates
    assert read_facts(directory / "run" / "reward.pt")["facts"]["audit"]["reasons"] == verdict["reasons"]


def test_a_reward_that_fails_its_audit_stops_the_pipeline(demonstration_run, tmp_path):
    _, directory = demonstration_run
    cfg = configure(*SMALL, f"cache={directory / 'cache'}", "audit.required=true")
    with pytest.raises(ValueError, match=r"fails its audit .* audit\.required=false"):
        run(cfg, tmp_path)
    assert (tmp_path / "audit" / "audit.md").exists()
    assert not (tmp_path / "reward.pt").exists()


@pytest.mark.parametrize("ablation", ["no_human", "state_reward"])
def test_ablations_of_the_reward_are_configs(ablation, tmp_path):
    run(configure(*SMALL, f"cache={tmp_path}", f"ablation={ablation}"), tmp_path / "run")
    facts = read_facts(tmp_path / "run" / "reward.pt")
    assert ("action" in facts["inputs"]) == (ablation != "state_reward")
    features = facts["model"]["models"][0]["features"]
    assert features["observe_human"] == (ablation != "no_human")
    assert features["use_lidar"] == (ablation == "no_human")


def test_the_literal_recipe_is_one_word(tmp_path):
    words = ["ranking=literal", "ranking.levels=[0.0,0.9]", "ranking.members=[[observation,action]]"]
    run(configure(*SMALL, f"cache={tmp_path}", *words), tmp_path / "run")
    assert read_facts(tmp_path / "run" / "reward.pt")["model"]["class"] == "RewardModel"


def test_demonstrations_may_fill_the_replay_buffer(tmp_path):
    words = [*SMALL, f"cache={tmp_path}", "replay.demonstrations=true"]
    cfg = configure(*words)
    run(cfg, tmp_path / "run")
    trainer = trainer_for(cfg, tmp_path / "again")  # the run has put the reward's place into cfg
    stored, data = trainer.replay_buffer[:], make_demonstrations(cfg)
    assert len(stored) == len(data)
    assert torch.equal(stored["action"], data["executed_action"])
    reward = load_reward(tmp_path / "run" / "reward.pt")(data["observation"], data["executed_action"])
    paid = stored["next", "reward"] / cfg.replay.reward_scale
    torch.testing.assert_close(paid[:, 1], 10 * (reward - 1), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(paid[:, [0, 2, 3]], data["next", "reward"], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(stored["preference"].sum(-1), torch.ones(len(data)))


def test_demonstrations_without_the_human_cannot_fill_the_replay_buffer(tmp_path):
    words = [*SMALL, f"cache={tmp_path}", "replay.demonstrations=true", "ablation=no_human"]
    with pytest.raises(ValueError, match=r"replay\.demonstrations needs"):
        run(configure(*words), tmp_path / "run")


def terms_of(directory, *words):
    return trainer_for(configure(*words), directory).loss_module.terms


def test_a_clone_guides_the_actor_and_a_search_may_stand_beside_it(demonstration_run, tmp_path):
    _, directory = demonstration_run
    shared = [*SMALL, f"cache={directory / 'cache'}", f"objectives.demo.reward.path={directory / 'run' / 'reward.pt'}"]
    proposals = terms_of(tmp_path / "both", *shared)["proposals"]
    assert proposals.entries == {"demo": 0}
    assert proposals.clones["demo"].module.num_preferences == 0
    assert proposals.search is not None
    proposals = terms_of(tmp_path / "guided", *shared, "loss.search=null")["proposals"]
    assert proposals.entries == {"demo": 0}
    assert proposals.search is None
    for number, words in enumerate([(*shared, "loss.guidance=null"), ("recipe=analytical",)]):
        proposals = terms_of(tmp_path / f"without_{number}", *words)["proposals"]
        assert len(proposals.clones) == 0
        assert proposals.search is not None
    assert list(terms_of(tmp_path / "neither", "recipe=analytical", "loss.search=null")) == ["angle"]


def test_a_reward_is_not_normalised_by_noisy_roll_outs(demonstration_run, tmp_path):
    _, directory = demonstration_run
    cfg = configure(*SMALL, f"cache={directory / 'cache'}", "ranking.normalise=true", "ranking.levels=[0.1,0.9]")
    with pytest.raises(ValueError, match=r"begin ranking\.levels with 0, not 0\.1"):
        run(cfg, tmp_path)
