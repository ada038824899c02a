"""Several objectives that learn from demonstrations of their own, be they an oracle's or recorded."""

import json
import shutil
import sys

import pytest
import torch
from support import BRIEF, configure

from morlnav import load
from morlnav.commands import audit as audit_command
from morlnav.commands.train import run
from morlnav.modules import load_module, read_facts
from morlnav.navigation.demonstrations import load_demonstrations, record_demonstrations, save_demonstrations
from morlnav.navigation.modules import CircumnavigationOracle, PassingOracle
from morlnav.navigation.world import SceneSampler
from morlnav.runs import Run, make_training
from morlnav.runs.trust import foreign_targets

NAMES = ["baseline", "demo", "wide_left", "recorded", "distance", "efficiency"]


def record(folder, num=4, seed=0):
    sampler = SceneSampler(distance=(5.0, 6.0))
    data, _ = record_demonstrations(CircumnavigationOracle(), sampler, num, seed=seed, num_envs=8)
    save_demonstrations(data, folder)
    return data


def words(directory):
    folder = f"rewards.demonstrations.recorded.path={directory / 'recording'}"
    return [f"objectives=[{','.join(NAMES)}]", f"cache={directory / 'cache'}", folder, *BRIEF]


def pipeline_of(*overrides):
    return make_training(configure(*overrides)).pipeline()


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    directory = tmp_path_factory.mktemp("styles")
    record(directory / "recording")
    run(configure(*words(directory), "trainer.total_frames=128"), directory / "run")
    return directory


def test_six_entries_of_the_reward_are_trained_at_once(many):
    policy = load(many / "run")
    assert policy.objectives == tuple(NAMES[1:])
    assert policy(torch.zeros(34), torch.eye(5)[1]).shape == (2,)
    header = (many / "run" / "evaluation" / "episodes.csv").read_text().splitlines()[0].split(",")
    assert {"frechet", "frechet_wide_left", "return_recorded"} <= set(header)


def test_every_demonstrated_objective_has_a_reward_a_clone_and_an_audit_of_its_own(many):
    rewards, clones = set(), set()
    for place in ("", "styles/wide_left", "styles/recorded"):
        folder = many / "run" / place
        assert json.loads((folder / "audit" / "audit.json").read_text())["reasons"]  # nothing is learned in seconds
        rewards.add((folder / "reward.pt").read_bytes())
        clones.add((folder / "clone.pt").read_bytes())
    assert len(rewards) == len(clones) == 3
    assert "frechet" in read_facts(many / "run/styles/recorded/reward.pt")["clone"]


def test_one_pipeline_learns_all_of_them_each_from_its_own_oracle(many):
    pipeline = pipeline_of(*words(many))
    assert pipeline.names == ["demo", "wide_left", "recorded"]
    for name, style in {"demo": CircumnavigationOracle(), "wide_left": PassingOracle(radius=2.0)}.items():
        data = pipeline.demonstrations[name].collect(3)
        assert torch.allclose(style(data["observation"]), data["action"], atol=1e-5)


def test_every_entry_pays_what_its_own_reward_says(many):
    finished = Run(many / "run")
    env = finished.training.make_env({name: reward.transform for name, reward in finished.learned.items()})
    step = env.rand_step(env.reset())
    for entry, place in enumerate(("", "styles/wide_left", "styles/recorded"), start=1):
        model = load_module(many / "run" / place / "reward.pt")
        paid = 10 * (model(step["observation"], step["action"]) - 1)
        torch.testing.assert_close(step["next", "reward"][:, entry], paid)


def test_recorded_demonstrations_enter_the_pipeline_as_they_are(many):
    data = pipeline_of(*words(many)).demonstrations["recorded"].collect(100)
    assert (data == load_demonstrations(many / "recording")).all()


def test_further_styles_leave_the_cache_of_demo_alone(many):
    alone = pipeline_of("objectives=[baseline,demo,distance,efficiency]", f"cache={many / 'cache'}", *BRIEF)
    names = {name: stages.digest("audit") for name, stages in pipeline_of(*words(many)).stages.items()}
    assert names["demo"] == alone.stages["demo"].digest("audit")
    assert len(set(names.values())) == 3


def test_another_recording_in_the_same_place_is_another_stage(tmp_path):
    names = []
    for seed in (0, 1):
        record(tmp_path / "recording", 1, seed)
        stages = pipeline_of(*words(tmp_path)).stages
        names.append({name: stages[name].digest("demonstrations") for name in stages})
        shutil.rmtree(tmp_path / "recording")
    changed = [name for name in names[0] if names[0][name] != names[1][name]]
    assert changed == ["recorded"]


def test_every_clone_guides_toward_its_own_corner(many, tmp_path):
    finished = Run(many / "run")
    trainer = finished.training.make_trainer(tmp_path, finished.learned)
    term = trainer.loss_module.terms["proposals"]
    assert term.entries == {"demo": 0, "wide_left": 1, "recorded": 2}
    first, second, _ = (clone.module(torch.ones(1, 34)) for clone in term.clones.values())
    assert not torch.equal(first, second)


def test_the_clone_stands_in_for_whoever_was_recorded(many):
    finished = Run(many / "run")
    learned, clone = finished.learned, load_module(many / "run/styles/recorded/clone.pt")
    assert torch.equal(learned["recorded"].demonstrator(torch.ones(3, 34)), clone(torch.ones(3, 34)))
    assert isinstance(learned["demo"].demonstrator, CircumnavigationOracle)
    paths = finished.evaluation.references(finished.evaluation.scenes(2))
    assert list(paths)[:2] == ["demo", "wide_left"]  # the clone of a smoke run hardly reaches a goal


def test_a_clone_that_drives_elsewhere_is_found_out(many):
    source, data = pipeline_of(*words(many)).demonstrations["recorded"], load_demonstrations(many / "recording")
    facts, reasons = source.judge(CircumnavigationOracle(), data)
    assert facts["clone"]["frechet"] < 1e-3
    assert reasons == []
    _, reasons = source.judge(PassingOracle(clockwise=False), data)
    assert "off the recorded paths" in reasons[0]
    facts, _ = source.judge(CircumnavigationOracle(), data[data["step"] == 0])  # of one transition each
    assert facts["clone"]["episodes"] == 4


def test_the_audit_of_any_of_them_can_be_repeated(many, tmp_path, monkeypatch, capsys):
    command = ["morlnav-audit", str(many / "run"), "--scenes", "2", "--plans", "0", "--threads", "1"]
    monkeypatch.setattr(sys, "argv", [*command, "--objective", "wide_left", "--output", str(tmp_path / "audit")])
    reward = many / "run" / "styles" / "wide_left" / "reward.pt"
    before = read_facts(reward)
    with pytest.raises(SystemExit):
        audit_command.main()
    assert (tmp_path / "audit" / "audit.md").is_file()
    assert read_facts(reward) == before  # a trial written elsewhere does not change the run
    assert f"are in {tmp_path / 'audit'}" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", [*command, "--objective", "distance"])
    with pytest.raises(SystemExit, match=r"no reward of distance; it learned \['demo', 'wide_left', 'recorded'\]"):
        audit_command.main()


def test_a_foreign_class_in_a_style_is_noticed(many, tmp_path):
    config = Run(many / "run").config
    assert foreign_targets(config) == []
    shutil.copy(many / "run" / "config.yaml", tmp_path)
    text = (tmp_path / "config.yaml").read_text()
    (tmp_path / "config.yaml").write_text(text.replace("morlnav.navigation.modules.PassingOracle", "os.system"))
    with pytest.raises(ValueError, match=r"foreign os\.system"):
        Run(tmp_path)


def test_recorded_demonstrations_may_be_those_of_the_run(tmp_path):
    record(tmp_path / "recording", 2)
    overrides = ["objectives=[baseline,demo,distance]", "demonstrations=recorded", "cache=null"]
    folder = "rewards.demonstrations.demo.path"
    source = pipeline_of(*overrides, f"{folder}={tmp_path / 'recording'}", "rewards.demonstrations.demo.replay=true")
    data = source.demonstrations["demo"].collect(5)
    assert data["episode"].unique().tolist() == list(range(5))  # replayed among other boxes
    with pytest.raises(FileNotFoundError, match="nowhere holds no demonstrations"):
        pipeline_of(*overrides, f"{folder}={tmp_path / 'nowhere'}")


@pytest.mark.parametrize("style", ["wide_left", "slow_pass", "wait"])
def test_a_style_is_one_word(style):
    pipeline = pipeline_of("objectives=[baseline,demo,distance]", f"demonstrations={style}", "cache=null")
    policy = pipeline.demonstrations["demo"].policy
    assert vars(policy).keys() == vars(type(policy)()).keys()
    assert isinstance(policy, PassingOracle)
