import json
import math
from dataclasses import replace

import pandas as pd
import pytest
import torch
from matplotlib.patches import Circle
from omegaconf import OmegaConf
from support import configure

from morlnav.commands.audit import audit as audit_saved
from morlnav.commands.audit import main
from morlnav.modules import Actor, RewardEnsemble, RewardModel, read_facts, save_module
from morlnav.navigation.audit import Thresholds, alternative_behaviours, audit_reward, plots, write_audit
from morlnav.navigation.evaluation import Outcome, evaluation_scenes
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import DifferentialDrive, Lidar, SceneSampler, TensorWorld
from morlnav.runs import Run

SMALL = {"action_low": [0.0, -3.14], "action_high": [0.5, 3.14], "features": 34, "depth": 1, "num_cells": 8}


def small_reward():
    return RewardModel(("observation", "action"), **SMALL)


@pytest.fixture(scope="module")
def scenes():
    return evaluation_scenes(10, seed=11, sampler=SceneSampler(num_boxes=1, distance=(6.0, 8.0)))


@pytest.fixture(scope="module")
def audit(scenes, ideal):
    return audit_reward(ideal, scenes=scenes, plans=2, bare=True, levels=(0.0, 0.25, 0.5))


def test_a_reward_for_the_demonstration_passes(audit):
    assert audit.reasons == []
    assert audit.passed
    assert audit.facts["target_rank"] == 1
    assert audit.facts["target_reward"] > 0.85


def test_every_behaviour_is_compared_in_the_scenes_that_both_manage(audit, scenes):
    frame = audit.behaviours.set_index("behaviour")
    assert len(frame) == 15
    assert 0 < frame.loc["wrong side", "pairs"] <= frame.loc["target", "pairs"] <= len(scenes)
    assert frame.loc["idle", "pairs"] == frame.loc["target", "pairs"]
    assert ((frame["margin_low"] <= frame["margin"]) & (frame["margin"] <= frame["margin_high"]))[1:].all()
    # Standing still earns a tenth in the start, where the shape is perfect: 250 steps of 10·(0.1 - 1).
    assert frame.loc["idle", "score"] == pytest.approx(-2250, abs=1)
    assert frame.loc["idle", "mean_reward"] == pytest.approx(0.1, abs=1e-3)


def test_the_reward_falls_with_noise_and_prefers_less_of_it(audit):
    assert audit.noise["mean_reward"].is_monotonic_decreasing
    assert audit.facts["noise_correlation"] == pytest.approx(-1)
    correlations = [audit.facts[name] for name in ("mean_spearman", "return_spearman", "return_kendall")]
    assert all(-1 <= value <= 1 for value in correlations)
    assert audit.noise["baseline"][0] > audit.noise["baseline"][2]
    assert audit.facts["pair_accuracy"] > 0.7
    assert audit.calibration["pairs"].sum() == 20000
    assert ((audit.calibration["empirical"] >= 0) & (audit.calibration["empirical"] <= 1)).all()


def test_the_plan_is_judged(audit):
    assert audit.plans[["boxes", "outcome", "human_on_right"]].values.tolist() == [[1, "goal", True], [0, "goal", True]]
    assert len(audit.planned) == len(audit.references) == 2
    assert audit.plans["frechet"].between(0.0, 0.45).all()
    assert (audit.plans["earned"] >= audit.plans["target_earned"] - 10).all()  # but for the grid, an optimum
    assert audit.plans["earned"].lt(0).all()


def brief(reward, scenes, *names, **settings):
    """An audit with a few alternatives in a few scenes."""
    scenes = scenes[:4]
    suite = {name: alternative_behaviours(scenes)[name] for name in (*names, "taut 1.0", "idle")}
    return audit_reward(reward, scenes=scenes, alternatives=suite, levels=(0.0, 0.5), **settings)


def test_a_flat_reward_fails(scenes):
    flat = brief(lambda observation, action: torch.full_like(action[:, 0], 0.9), scenes, plans=0)
    assert not flat.passed
    assert flat.facts["target_rank"] > 1
    assert any("'taut 1.0'" in reason for reason in flat.reasons)
    assert any("does not fall with noise" in reason for reason in flat.reasons)
    assert math.isnan(flat.facts["noise_correlation"])
    assert flat.summary()["noise_correlation"] is None


def test_the_printed_offset_pays_for_idling(scenes, ideal):
    printed = brief(ideal, scenes, plans=0, offset=1.0)
    assert not printed.passed
    assert printed.facts["idle_margin"] < 0
    assert any("'idle'" in reason for reason in printed.reasons)


def test_a_reward_for_hurrying_is_found_out_by_its_plan(scenes):
    hurried = brief(lambda observation, action: action[:, 0] / 0.5, scenes, plans=1)
    assert any(reason.startswith("The path that the reward likes best") for reason in hurried.reasons)


def test_an_alternative_that_drives_like_the_target_is_not_judged(scenes, ideal):
    mirrored = brief(ideal, scenes, "wrong side", plans=0, oracle=CircumnavigationOracle(clockwise=False))
    frame = mirrored.behaviours.set_index("behaviour")
    assert frame.loc["wrong side", "margin"] == 0
    assert frame["required"].isna().to_dict() == {"target": True, "wrong side": True, "taut 1.0": False, "idle": False}
    assert not any("wrong side" in reason for reason in mirrored.reasons)
    assert brief(ideal, scenes, "half speed", plans=0).behaviours["required"].notna().sum() == 3


def test_thresholds_decide(scenes, ideal):
    wanted = Thresholds(clear_margin=1e4, target_reward=0.999, noise_correlation=-2.0)
    reasons = brief(ideal, scenes, plans=0, thresholds=wanted).reasons
    assert len(reasons) == 3
    assert "'taut 1.0'" in reasons[0]
    assert "must exceed 10000" in reasons[0]
    assert "mean reward is" in reasons[1]
    assert "does not fall" in reasons[2]


def test_the_report_holds_verdict_tables_and_figures(audit, tmp_path):
    report = write_audit(audit, tmp_path / "audit")
    files = {file.name for file in (tmp_path / "audit").iterdir()}
    tables = {"behaviours.csv", "noise.csv", "calibration.csv", "plans.csv"}
    assert files == tables | {"audit.json", "audit.md", "margins.png", "noise.png", "plans.png"}
    assert report.startswith("**Passed.**")
    assert "| swerve 0.55 |" in report
    assert json.loads((tmp_path / "audit" / "audit.json").read_text())["passed"] is True
    assert len(pd.read_csv(tmp_path / "audit" / "behaviours.csv")) == 15


def test_planned_scenes_are_drawn_in_the_sizes_of_their_world(audit, tmp_path, monkeypatch):
    figures, plot_plans = [], plots.plot_plans
    monkeypatch.setattr(
        plots, "plot_plans", lambda *args, **sizes: figures.append(plot_plans(*args, **sizes)) or figures[0]
    )
    world = TensorWorld(robot=DifferentialDrive(radius=0.25), human_radius=0.4)
    write_audit(replace(audit, world=world), tmp_path)
    assert {0.25, 0.4} <= {patch.radius for patch in figures[0].axes[0].patches if isinstance(patch, Circle)}


def test_the_command_line_judges_a_saved_reward(tmp_path, monkeypatch, capsys):
    file = tmp_path / "reward.pt"
    save_module(RewardEnsemble([small_reward(), small_reward()]), file, {"held_out": {"accuracy": 0.5}})
    monkeypatch.setattr("sys.argv", ["morlnav-audit", str(tmp_path), "--scenes", "2", "--plans", "0", "--threads", "1"])
    with pytest.raises(SystemExit) as status:
        main()
    assert status.value.code == 1
    assert "**Failed.**" in capsys.readouterr().out
    facts = read_facts(file)
    assert facts["held_out"] == {"accuracy": 0.5}
    assert facts["audit"]["passed"] is False
    assert facts["audit"]["settings"]["num_scenes"] == 2
    assert facts["audit"]["reasons"]
    assert (file.parent / "audit" / "audit.md").is_file()
    assert audit_saved(file, num_scenes=2, plans=0) == audit_saved(tmp_path, num_scenes=2, plans=0)

    monkeypatch.setattr("sys.argv", ["morlnav-audit", str(tmp_path / "nowhere")])
    with pytest.raises(SystemExit, match="There is no reward model"):
        main()


def test_a_run_is_judged_by_its_own_demonstrator_and_scale(tmp_path):
    changes = ["rewards.demonstrations.demo.policy.radius=0.75", "rewards.scale=3.0", "env.scenes.num_boxes=0"]
    cfg = configure("objectives=[baseline,demo,distance,efficiency]", "cache=null", *changes)
    OmegaConf.save(cfg, tmp_path / "config.yaml", resolve=True)
    origin = Run(tmp_path).training.pipeline().stages["demo"].origin("ranking")
    save_module(small_reward(), tmp_path / "reward.pt", {"origin": origin})
    save_module(Actor(num_objectives=0, **SMALL), tmp_path / "clone.pt")
    passed, report = audit_saved(tmp_path, num_scenes=2, plans=0)
    assert not passed
    assert report == tmp_path / "audit"
    frame = pd.read_csv(report / "behaviours.csv").set_index("behaviour")
    assert frame.loc["radius 0.75", "margin"] == 0
    assert frame.loc["target", "pairs"] == 2
    verdict = read_facts(tmp_path / "reward.pt")["audit"]
    assert verdict["settings"]["scale"] == 3.0


def test_a_target_that_never_arrives_is_no_target(scenes, ideal):
    with pytest.raises(ValueError, match="goal in no scene"):
        audit_reward(ideal, scenes=scenes[:2], oracle=lambda observation: torch.zeros(len(observation), 2), plans=0)


def test_another_robot_and_lidar_are_judged_by_behaviours_of_their_own():
    world = TensorWorld(DifferentialDrive(max_speed=0.3), Lidar(sectors=60))
    free = evaluation_scenes(2, sampler=SceneSampler(num_boxes=0))
    for name in ("radius 1.6", "taut 1.6"):
        rollouts = alternative_behaviours(free, world=world)[name].drive(free, world=world)
        assert (rollouts.outcome == Outcome.GOAL).all()
        assert rollouts.action[..., 0].max() == pytest.approx(0.3)
