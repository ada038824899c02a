"""Rewards from demonstrations: learned, kept by what they depend on, judged, and paid in the training."""

import json

import pytest
import torch
from support import BRIEF, DEMONSTRATED, configure, trainer_for

from morlnav import load
from morlnav.commands.evaluate import main as evaluate_main
from morlnav.commands.train import run
from morlnav.modules import RewardModel, load_module, read_facts
from morlnav.navigation.modules import NavigationFeatures
from morlnav.runs import Run, make_training
from morlnav.trainers import DREX, Cloning, Ranking

SMALL = [*BRIEF, DEMONSTRATED]
SEEDED = "hooks.seed_replay={_target_: morlnav.navigation.demonstrations.SeedReplay}"


@pytest.fixture(scope="module")
def demonstration_run(tmp_path_factory):
    directory = tmp_path_factory.mktemp("demonstrations")
    cfg = configure(*SMALL, f"cache={directory / 'cache'}")
    run(cfg, directory / "run")
    return cfg, directory


def again(directory, *words):
    """The training of that run with other words; what it learned comes from the cache."""
    return make_training(configure(*SMALL, f"cache={directory / 'cache'}", *words))


def test_demonstrations_become_the_first_tuneable_objective(demonstration_run):
    _, directory = demonstration_run
    policy = load(directory / "run")
    assert policy.objectives == ("demo", "distance", "efficiency")
    assert policy(torch.zeros(34), torch.tensor([1.0, 0.0, 0.0])).shape == (2,)


def test_the_run_keeps_its_reward_model_and_needs_nothing_else(demonstration_run, tmp_path, monkeypatch, capsys):
    _, directory = demonstration_run
    assert "held_out" in read_facts(directory / "run" / "reward.pt")
    moved = (directory / "run").rename(tmp_path / "moved")
    hidden = (directory / "cache").rename(tmp_path / "hidden")
    monkeypatch.chdir(tmp_path)
    settings = ("--episodes=1", "--steps=1", "--threads=1", "--output=again")
    monkeypatch.setattr("sys.argv", ["morlnav-evaluate", "moved", *settings])
    try:
        assert load("moved").objectives[0] == "demo"
        evaluate_main()
        assert not (directory / "cache").exists()
    finally:
        moved.rename(directory / "run")
        hidden.rename(directory / "cache")
    shown = capsys.readouterr().out
    assert "Fréchet m" in shown
    assert "Audit of demo: " in shown
    assert (tmp_path / "again" / "table.md").is_file()


def test_every_stage_is_cached_by_its_config(demonstration_run):
    _, directory = demonstration_run
    names = {path.name.partition("-")[0] for path in (directory / "cache").iterdir()}
    assert names == {"demonstrations", "clone", "ranking", "audit"}
    first, second = (
        again(directory, *words).pipeline().stages["demo"] for words in ([], ["rewards.ranking.snippet=9"])
    )
    changed = [name for name in first.config if first.digest(name) != second.digest(name)]
    assert changed == ["ranking", "audit"]


def test_what_is_paid_and_to_how_many_leaves_the_cache_alone(demonstration_run):
    _, directory = demonstration_run
    words = [
        "env.num_envs=8",
        "env.inflation=0.03",
        "+env.objectives.calm={_target_: morlnav.navigation.envs.Efficiency}",
    ]
    digests = [again(directory, *more).pipeline().stages["demo"].digest("audit") for more in ([], words)]
    assert digests[0] == digests[1]
    assert digests[0] != again(directory, "env.scenes.num_boxes=1").pipeline().stages["demo"].digest("audit")


def test_the_report_measures_the_distance_to_the_demonstration(demonstration_run):
    _, directory = demonstration_run
    assert "frechet" in (directory / "run" / "evaluation" / "episodes.csv").read_text().splitlines()[0]


def test_the_environment_pays_what_the_reward_says(demonstration_run):
    _, directory = demonstration_run
    learned = Run(directory / "run").learned
    model = load_module(directory / "run" / "reward.pt")
    env = again(directory).make_env({name: reward.transform for name, reward in learned.items()})
    step = env.rand_step(env.reset())
    paid = 10 * (model(step["observation"], step["action"]) - 1)
    torch.testing.assert_close(step["next", "reward"][:, 1], paid)
    assert step["next", "reward"].shape == (16, 4)


def test_the_run_keeps_the_audit_of_its_reward(demonstration_run):
    _, directory = demonstration_run
    verdict = json.loads((directory / "run" / "audit" / "audit.json").read_text())
    assert not verdict["passed"]  # nothing is learned in five updates
    assert read_facts(directory / "run" / "reward.pt")["audit"]["reasons"] == verdict["reasons"]


def test_a_reward_that_fails_its_audit_stops_the_pipeline(demonstration_run, tmp_path):
    _, directory = demonstration_run
    cfg = configure(*SMALL, f"cache={directory / 'cache'}", "rewards.audit.required=true")
    with pytest.raises(ValueError, match=r"fails its audit .* rewards\.audit\.required=false"):
        run(cfg, tmp_path)
    assert (tmp_path / "audit" / "audit.md").exists()
    assert not (tmp_path / "reward.pt").exists()


def test_ablations_together_reach_every_network(tmp_path):
    small = [word for word in SMALL if "members" not in word]  # which a word would set last
    training = make_training(configure(*small, f"cache={tmp_path}", "ablation=[no_human,state_reward]"))
    learned = training.learn_rewards(tmp_path / "run")
    model = load_module(tmp_path / "run" / "reward.pt")
    assert {member.inputs for member in model.modules() if isinstance(member, RewardModel)} == {("observation",)}
    loss = training.make_trainer(tmp_path, learned).loss_module
    for network in (model, learned["demo"].clone, loss.actor_network, loss.qvalue_network):
        features = [part for part in network.modules() if isinstance(part, NavigationFeatures)]
        assert features
        assert not any(part.observe_human for part in features)
    assert model.models[0].features.use_lidar


def test_the_literal_recipe_is_one_word(tmp_path):
    words = ["ranking=literal", "rewards.ranking.levels=[0.0,0.9]", "rewards.ranking.members=[[observation,action]]"]
    learned = make_training(configure(*SMALL, "cache=null", *words)).learn_rewards()
    assert type(learned["demo"].transform.reward_model).__name__ == "RewardModel"
    assert learned["demo"].transform.offset == 1.0


def test_so_many_demonstrations_are_made_as_the_config_says(demonstration_run):
    _, directory = demonstration_run
    data = again(directory).learn_rewards()["demo"].demonstrations
    assert data["episode"].unique().tolist() == [0, 1, 2, 3]
    with pytest.raises(ValueError, match=r"num must be at least 1, got 0"):
        again(directory, "rewards.num=0").pipeline()


def test_demonstrations_may_lie_in_the_replay_buffer_from_the_beginning(demonstration_run, tmp_path):
    _, directory = demonstration_run
    training = again(directory, SEEDED)
    learned = training.learn_rewards()
    trainer, data = training.make_trainer(tmp_path, learned), learned["demo"].demonstrations
    stored = trainer.replay_buffer.storage[:]
    assert len(stored) == len(data)
    assert torch.equal(stored["action"], data["executed_action"])
    reward = load_module(directory / "run" / "reward.pt")(data["observation"], data["executed_action"])
    paid = stored["next", "reward"]
    torch.testing.assert_close(paid[:, 1], 10 * (reward - 1), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(paid[:, [0, 2, 3]], data["next", "reward"], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(stored["preference"].sum(-1), torch.ones(len(data)))
    trainer.train()
    assert len(trainer.replay_buffer) == len(data) + 512


def test_demonstrations_without_the_human_cannot_fill_the_replay_buffer(tmp_path):
    with pytest.raises(ValueError, match=r"hooks\.seed_replay: .* env\.observe_human=true"):
        run(configure(*SMALL, f"cache={tmp_path / 'cache'}", SEEDED, "ablation=no_human"), tmp_path / "run")
    assert not list(tmp_path.iterdir())  # before anything is learned


def test_a_clone_guides_the_actor_and_a_search_may_stand_beside_it(demonstration_run, tmp_path):
    _, directory = demonstration_run

    def terms_of(*words):
        training = again(directory, *words)
        return training.make_trainer(tmp_path, training.restore_rewards(directory / "run")).loss_module.terms

    proposals = terms_of()["proposals"]
    assert proposals.entries == {"demo": 0}
    assert proposals.clones["demo"].module.num_objectives == 0
    assert proposals.search is not None
    guided = terms_of("loss.terms.proposals.search=null")["proposals"]
    assert guided.entries == {"demo": 0}
    assert guided.search is None
    assert len(terms_of("loss.terms.proposals.guidance=null")["proposals"].clones) == 0
    alone = trainer_for(configure("recipe=analytical"), tmp_path).loss_module.terms["proposals"]
    assert len(alone.clones) == 0
    assert alone.search is not None
    neither = trainer_for(configure("recipe=analytical", "loss.terms.proposals=null"), tmp_path)
    assert sorted(neither.loss_module.terms) == ["angle"]


def test_a_reward_is_not_normalised_by_noisy_roll_outs(tmp_path):
    cfg = configure(*SMALL, "rewards.ranking.normalise=true", "rewards.ranking.levels=[0.1,0.9]")
    with pytest.raises(ValueError, match=r"rewards\.ranking.* begin levels with 0, not 0\.1"):
        run(cfg, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_the_pipeline_is_made_of_the_parts_that_the_config_names(demonstration_run):
    pipeline = again(demonstration_run[1]).pipeline()
    assert [type(pipeline), type(pipeline.clone), type(pipeline.ranking)] == [DREX, Cloning, Ranking]
