"""Several objectives that learn from demonstrations of their own, be they an oracle's or recorded."""

import json
import sys

import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from support import BRIEF, configure, trainer_for

from morlnav import load
from morlnav.data import load_demonstrations, record_demonstrations, save_demonstrations
from morlnav.modules import CircumnavigationOracle, PassingOracle, read_facts
from morlnav.policy import check_targets, load_config
from morlnav.train import run
from morlnav.trainers.drex import judge_clone, make_demonstrations, stage_directory
from morlnav.trainers.origins import use_own_offsets
from morlnav.trainers.styles import (
    demonstrated_objectives,
    demonstrated_paths,
    make_clone,
    make_demonstrator,
    style_config,
)

NAMES = ["baseline", "demo", "wide_left", "recorded", "distance", "efficiency"]


def record(folder, num=4, seed=0):
    sampler = SceneSampler(distance=(5.0, 6.0))
    data, _ = record_demonstrations(CircumnavigationOracle(), sampler, num, seed=seed, num_envs=8)
    save_demonstrations(data, folder)
    return data


def words(directory):
    folder = f"styles.recorded.demonstrations.path={directory / 'recording'}"
    return [f"objectives=[{','.join(NAMES)}]", f"cache={directory / 'cache'}", folder]


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    directory = tmp_path_factory.mktemp("styles")
    record(directory / "recording")
    cfg = configure(*words(directory), *BRIEF, "trainer.total_frames=128")
    run(cfg, directory / "run")
    return cfg, directory


def test_six_entries_of_the_reward_are_trained_at_once(many):
    _, directory = many
    policy = load(directory / "run")
    assert policy.objectives == tuple(NAMES[1:])
    assert policy(torch.zeros(34), torch.eye(5)[1]).shape == (2,)
    header = (directory / "run" / "evaluation" / "episodes.csv").read_text().splitlines()[0].split(",")
    assert {"frechet", "frechet_wide_left", "return_recorded"} <= set(header)


def test_every_demonstrated_objective_has_a_reward_and_an_audit_of_its_own(many):
    _, directory = many
    weights = {}
    for place in ("", "styles/wide_left", "styles/recorded"):
        folder = directory / "run" / place
        assert json.loads((folder / "audit" / "audit.json").read_text())["reasons"]  # nothing is learned in seconds
        weights[place] = (folder / "reward.pt").read_bytes()
    assert len(set(weights.values())) == 3
    assert "frechet" in read_facts(directory / "run/styles/recorded/reward.pt")["facts"]["clone"]


def test_each_is_demonstrated_by_its_own_oracle(many):
    cfg, _ = many
    assert demonstrated_objectives(cfg) == ["demo", "wide_left", "recorded"]
    for name, style in {"demo": CircumnavigationOracle(), "wide_left": PassingOracle(radius=2.0)}.items():
        data = make_demonstrations(style_config(cfg, name))
        assert torch.allclose(style(data["observation"]), data["action"], atol=1e-5)


def test_recorded_demonstrations_enter_the_pipeline_as_they_are(many):
    cfg, directory = many
    data = make_demonstrations(style_config(cfg, "recorded"))
    assert (data == load_demonstrations(directory / "recording")).all()


def test_further_styles_leave_the_cache_of_demo_alone(many):
    cfg, _ = many
    alone = configure("objectives=[baseline,demo,distance,efficiency]", f"cache={cfg.cache}", *BRIEF)
    groups = ("world", "env", "demonstrations")
    names = {name: stage_directory(style_config(cfg, name), *groups) for name in ("demo", "wide_left", "recorded")}
    assert names["demo"] == stage_directory(alone, *groups)
    assert len(set(names.values())) == 3


def test_another_recording_in_the_same_place_is_another_stage(tmp_path):
    record(tmp_path / "recording", 1)
    first = stage_directory(style_config(configure(*words(tmp_path)), "recorded"), "demonstrations")
    (tmp_path / "recording").rename(tmp_path / "old")
    record(tmp_path / "recording", 1, seed=1)
    second = stage_directory(style_config(configure(*words(tmp_path)), "recorded"), "demonstrations")
    assert first != second


def test_every_clone_guides_toward_its_own_corner(many, tmp_path):
    _, directory = many
    cfg = load_config(directory / "run")
    term = trainer_for(cfg, tmp_path).loss_module.terms["proposals"]
    assert sorted(term.entries.values()) == [0, 1, 2]
    assert all(cfg.objectives[name] is not None for name in term.entries)
    first, second, _ = (clone.module(torch.ones(1, 34)) for clone in term.clones.values())
    assert not torch.equal(first, second)


def test_a_style_is_trained_with_the_offset_of_its_own_ranking(many):
    _, directory = many
    cfg = configure(*words(directory), "+styles.wide_left.ranking={offset: 0.5}")
    use_own_offsets(cfg)
    assert cfg.objectives.wide_left.offset == 0.5
    assert cfg.objectives.demo.offset == cfg.objectives.recorded.offset == cfg.ranking.offset != 0.5


def test_a_run_is_read_for_another_device_than_it_was_trained_on(many, tmp_path):
    _, directory = many
    cfg = OmegaConf.load(directory / "run" / "config.yaml")
    cfg.device = cfg.objectives.demo.reward.device = "cuda"
    OmegaConf.save(cfg, tmp_path / "config.yaml")
    assert load_config(tmp_path).objectives.demo.reward.device == "cpu"


def test_the_clone_stands_in_for_whoever_was_recorded(many):
    _, directory = many
    cfg = load_config(directory / "run")
    assert not (directory / "run" / "clone.pt").exists()
    stored = torch.load(directory / "run/styles/recorded/clone.pt", weights_only=True)
    clone = make_demonstrator(style_config(cfg, "recorded"), directory / "run")
    trained = make_clone(style_config(cfg, "recorded"))
    trained.load_state_dict(stored)
    assert torch.equal(clone(torch.ones(3, 34)), trained(torch.ones(3, 34)))
    scenes = SceneSampler(distance=(5.0, 6.0))(2, generator=torch.Generator().manual_seed(0))
    paths = demonstrated_paths(cfg, scenes, TensorWorld(), directory / "run")
    assert list(paths)[:2] == ["demo", "wide_left"]  # the clone of a smoke run hardly reaches a goal


def test_a_clone_that_drives_elsewhere_is_found_out(many):
    cfg, directory = many
    view, data = style_config(cfg, "recorded"), load_demonstrations(directory / "recording")
    facts, reasons = judge_clone(view, CircumnavigationOracle(), data)
    assert facts["clone"]["frechet"] < 1e-3
    assert reasons == []
    _, reasons = judge_clone(view, PassingOracle(clockwise=False), data)
    assert "off the recorded paths" in reasons[0]
    facts, _ = judge_clone(view, CircumnavigationOracle(), data[data["step"] == 0])  # of one transition each
    assert facts["clone"]["episodes"] == 4


def test_the_audit_of_any_of_them_can_be_repeated(many, tmp_path, monkeypatch, capsys):
    _, directory = many
    command = ["morlnav-audit", str(directory / "run"), "--scenes", "2", "--plans", "0", "--threads", "1"]
    monkeypatch.setattr(sys, "argv", [*command, "--objective", "wide_left", "--output", str(tmp_path / "audit")])
    reward = directory / "run" / "styles" / "wide_left" / "reward.pt"
    before = read_facts(reward)
    with pytest.raises(SystemExit):
        audit_command.main()
    assert (tmp_path / "audit" / "audit.md").is_file()
    assert read_facts(reward) == before  # a trial written elsewhere does not change the run
    assert f"are in {tmp_path / 'audit'}" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", [*command, "--objective", "distance"])
    with pytest.raises(SystemExit, match=r"no reward of distance; it learned \['demo', 'wide_left', 'recorded'\]"):
        audit_command.main()


def test_a_foreign_class_in_a_style_is_noticed(many):
    _, directory = many
    cfg = load_config(directory / "run")
    check_targets(cfg)
    OmegaConf.update(cfg, "styles.wide_left.demonstrations.policy._target_", "os.system")
    with pytest.raises(ValueError, match=r"foreign class os\.system"):
        check_targets(cfg)


def test_recorded_demonstrations_may_be_those_of_the_run(tmp_path):
    record(tmp_path / "recording", 2)
    overrides = ["objectives=[baseline,demo,distance]", "demonstrations=recorded", f"cache={tmp_path / 'cache'}"]
    cfg = configure(*overrides, f"demonstrations.path={tmp_path / 'recording'}", "demonstrations.num=5")
    data = make_demonstrations(cfg)
    assert data["episode"].unique().tolist() == list(range(5))  # replayed among other boxes
    with pytest.raises(Exception, match="holds no demonstrations"):
        make_demonstrations(configure(*overrides, f"demonstrations.path={tmp_path / 'nowhere'}"))


@pytest.mark.parametrize(("num", "others"), [("null", 1000), ("5", 5)])
def test_a_style_beside_a_recording_has_as_many_demonstrations(num, others):
    cfg = configure(
        "objectives=[baseline,demo,wide_left,distance]", "demonstrations=recorded", f"demonstrations.num={num}"
    )
    assert style_config(cfg, "wide_left").demonstrations.num == others


@pytest.mark.parametrize("style", ["wide_left", "slow_pass", "wait"])
def test_a_style_is_one_word(style):
    cfg = configure(f"demonstrations={style}", "demonstrations.num=1", "cache=nowhere")
    policy = instantiate(cfg.demonstrations.policy, _convert_="all")
    assert vars(policy).keys() == vars(type(policy)()).keys()
    assert isinstance(policy, PassingOracle)
