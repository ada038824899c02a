"""Whole trainings in seconds: every file is left behind, parts swap, mistakes read well, and resuming is exact."""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
import torch
from omegaconf import OmegaConf
from support import ANALYTICAL, SMALL, configure, trainer_for
from torchrl.checkpoint import CheckpointRotation

import morlnav.commands.train
from morlnav.cli import conf_dir
from morlnav.evaluate import evaluate_run
from morlnav.train import run
from morlnav.trainers.checkpoint import load_checkpoint
from morlnav.world import DifferentialDrive, Scene

BRIEF = ("trainer.total_frames=32", "trainer.random_frames=16", "evaluation.during.interval=16")


def latest(directory):
    return CheckpointRotation(directory / "checkpoints", keep_last=1).latest()


def learned(trainer):
    """Everything that a trainer has learned or will learn from, as nested dictionaries."""
    hooks = ("log_episodes", "log_optimisation", "evaluate_policy")
    return {
        "loss": trainer.loss_module.state_dict(),
        "average": trainer.checkpoint.components["average"].state_dict(),
        "stepper": trainer.optimization_stepper.state_dict(),
        "hooks": {name: trainer._modules[name].state_dict() for name in hooks},
        "replay": trainer.replay_buffer.storage[:].to_dict(),
        "gamma": trainer.loss_module.value_estimator.gamma,
        "frames": trainer.collected_frames,
        "random state": torch.get_rng_state(),
    }


def assert_identical(ours, theirs, name=""):
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys(), name
        for key in ours:
            assert_identical(ours[key], theirs[key], f"{name}.{key}")
    elif isinstance(ours, list | tuple):
        assert len(ours) == len(theirs), name
        for i, pair in enumerate(zip(ours, theirs, strict=True)):
            assert_identical(*pair, f"{name}[{i}]")
    elif isinstance(ours, torch.Tensor):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=0, equal_nan=True, msg=lambda text: f"{name}: {text}")
    else:
        assert ours == theirs, name


def train_briefly(directory, *overrides):
    """Two batches, the second with optimisation steps; returns the trainer and the losses it reported."""
    trainer = trainer_for(configure(*BRIEF, *overrides), directory)
    losses = []
    trainer.register_op("post_optim_complete_log", lambda _, values: losses.append(values.clone()))
    trainer.train()
    assert losses
    for name in ("loss_qvalue", "loss_actor", "pred_value", "grad_norm_qvalue"):
        assert losses[-1][name].isfinite().all(), name
    assert all(parameter.isfinite().all() for parameter in trainer.loss_module.parameters())
    return trainer, losses


# A whole run


def test_a_run_leaves_everything_behind(smoke_run):
    files = ["config.yaml", "policy.pt", "versions.json", "evaluation/table.md", "evaluation/trajectories.png"]
    files += [f"evaluation/{name}.csv" for name in ("episodes", "summary", "fidelity", "front")]
    for name in files:
        assert (smoke_run / name).stat().st_size > 0, name
    assert torch.__version__.startswith(json.loads((smoke_run / "versions.json").read_text())["torch"])
    assert len(list((smoke_run / "checkpoints").glob("checkpoint-*"))) == 2
    assert list((smoke_run / "logs").rglob("events.out.tfevents.*"))


def test_logged_losses_are_finite_and_episodes_are_counted(smoke_run):
    scalars = {path.stem: path for path in (smoke_run / "logs").rglob("*.csv")}
    assert {"loss_qvalue", "loss_actor", "gamma", "lr_actor", "expected_utility"} <= scalars.keys()
    for name in ("loss_qvalue", "loss_actor", "pred_value_distance", "grad_norm_actor", "angle_actor"):
        table = pd.read_csv(scalars[name], header=None, names=["step", "value"])
        assert len(table) >= 3, name
        assert table.value.map(math.isfinite).all(), name
        assert table.step.is_monotonic_increasing, name
        assert table.step.iloc[-1] <= 512, name


def test_a_finished_run_can_be_measured_again_elsewhere(smoke_run, tmp_path):
    table = evaluate_run(smoke_run, tmp_path, episodes=2, steps=1)
    assert "4 episodes: 2 preferences in 2 scenes" in table
    assert (tmp_path / "episodes.csv").is_file()


def test_one_seed_is_one_result(tmp_path):
    first, second, other = (
        train_briefly(tmp_path / name, f"seed={seed}")[0] for name, seed in (("a", 3), ("b", 3), ("c", 4))
    )
    assert_identical(learned(first), learned(second))
    assert not torch.equal(first.replay_buffer.storage[:]["observation"], other.replay_buffer.storage[:]["observation"])


def test_a_compiled_loss_learns_the_same(tmp_path):
    compiled, eager = (
        train_briefly(tmp_path / name, f"trainer.compile={value}")[0]
        for name, value in (("compiled", "{backend:eager}"), ("eager", "null"))
    )
    assert hasattr(compiled.loss_module.value_loss, "_torchdynamo_orig_callable")
    assert_identical(learned(compiled), learned(eager))


# Resuming


@pytest.mark.parametrize(
    ("batches", "overrides"),
    [
        (2, []),  # while actions are still random
        (11, ["env.max_steps=5"]),  # episodes end and begin anew; the actor's delayed update is pending
        (
            5,
            [
                "world=pymunk",
                "env.num_envs=4",
                "trainer.frames_per_batch=8",
                "loss.angle=paper",
                *BRIEF,
                "trainer.total_frames=64",
            ],
        ),
        (4, ["replay.capacity=64"]),  # the buffer is just full
        (7, ["replay.capacity=64", "replay.relabel.share=0.75", "replay.relabel.num_relabels=2"]),  # and more than full
        (7, ["replay=prioritised", "replay.relabel.num_relabels=2"]),
    ],
    ids=["random", "episodes", "pymunk", "full", "overwriting", "prioritised"],
)
def test_a_resumed_training_equals_an_unbroken_one_bit_for_bit(batches, overrides, tmp_path):
    cfg = configure(
        "trainer.total_frames=256", "trainer.policy_update_delay=3", "trainer.optim_steps_per_batch=1", *overrides
    )
    whole = trainer_for(cfg, tmp_path / "whole")
    whole.train()
    expected = learned(whole)

    stopped = trainer_for(cfg, tmp_path / "stopped")
    left = iter(range(batches - 1, -1, -1))
    stopped.register_op("post_steps", lambda: next(left, 0) or stopped.request_stop("enough"))
    stopped.train()
    assert stopped.collected_frames == batches * cfg.trainer.frames_per_batch

    resumed = trainer_for(cfg, tmp_path / "resumed")
    torch.manual_seed(99)
    load_checkpoint(resumed, latest(tmp_path / "stopped"))
    assert resumed.collected_frames == stopped.collected_frames
    reported, remembered = (t.optimization_stepper.state_dict()["actor_metrics"] for t in (stopped, resumed))
    assert reported == remembered
    resumed.train()
    assert_identical(learned(resumed), expected)


def test_ctrl_c_says_how_to_go_on_and_going_on_loses_nothing(smoke_run, tmp_path, monkeypatch, capsys):
    def interrupted_trainer(*args):
        trainer = morlnav.trainers.make_trainer(*args)
        trainer.register_op(
            "post_steps", lambda: os.kill(os.getpid(), signal.SIGINT) if trainer.collected_frames == 208 else None
        )
        return trainer

    monkeypatch.setattr(morlnav.commands.train, "make_trainer", interrupted_trainer)
    assert run(configure(), tmp_path) is None
    assert "Stopped after 208 frames" in (text := capsys.readouterr().out)
    assert f"morlnav-train resume={tmp_path}" in text
    assert not (tmp_path / "policy.pt").exists()

    monkeypatch.undo()
    run(configure(f"resume='{tmp_path}'"), tmp_path)
    assert "at 208 of 512 frames" in capsys.readouterr().out
    assert_identical(torch.load(tmp_path / "policy.pt"), torch.load(smoke_run / "policy.pt"))


def test_a_killed_run_goes_on_from_its_last_checkpoint_to_the_same_policy(smoke_run, train_command, tmp_path, capsys):
    directory = tmp_path / "0_seed=0,world=tensor"  # named as a sweep names its runs
    mine = tmp_path / "my_conf" / "preferences" / "mine.yaml"
    mine.parent.mkdir(parents=True)
    shutil.copy(Path(conf_dir()) / "preferences" / "corners.yaml", mine)
    words = [
        sys.executable,
        "-m",
        "morlnav.commands.train",
        "--config-dir",
        str(tmp_path / "my_conf"),
        "preferences=mine",
    ]
    words += [*SMALL, ANALYTICAL, f"hydra.run.dir='{directory}'"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        for _ in range(1200):
            if directory.is_dir() and list((directory / "checkpoints").glob("checkpoint-*/manifest.json")):
                break
            assert process.poll() is None, process.communicate()[1]
            time.sleep(0.05)
    finally:
        process.kill()
        process.communicate()
    assert not (directory / "policy.pt").exists()

    began = OmegaConf.load(directory / "config.yaml")
    other = OmegaConf.merge(began, {"loss": {"policy_noise": 0.7}})
    del other.loss.search
    OmegaConf.save(other, directory / "config.yaml")
    with pytest.raises(SystemExit, match=r"loss.policy_noise: 0.7 then, 0.1 now; loss.search.*: nothing then"):
        train_command(f"resume={directory}")
    OmegaConf.save(began, directory / "config.yaml")

    versions = json.loads((directory / "versions.json").read_text())
    (directory / "versions.json").write_text(json.dumps(versions | {"git": "another"}))
    train_command(f"resume={directory}")
    assert json.loads((directory / "versions.json").read_text()) == versions | {"git": "another", "resumed": [versions]}
    assert "Continuing from" in capsys.readouterr().out
    assert_identical(torch.load(directory / "policy.pt"), torch.load(smoke_run / "policy.pt"))


@pytest.mark.parametrize("path", ["nowhere", "."])
def test_resuming_from_a_place_without_checkpoints_says_so(path, tmp_path):
    with pytest.raises(FileNotFoundError, match="no checkpoint there; give a run directory"):
        run(configure(f"resume='{tmp_path / path}'"), tmp_path)


# Swapping parts


@pytest.mark.parametrize(
    "overrides",
    [
        ["world=pymunk", "env.num_envs=4"],
        ["preferences=dirichlet"],
        ["preferences=uniform"],
        ["preferences=segments"],
        ["preferences=grid"],
        ["preferences=fixed", "preferences.value=[0.5,0.5]"],
        ["loss.angle=none"],
        ["loss.angle=paper"],
        ["loss.angle=safe"],
        ["loss.num_qvalue_nets=3"],
        ["loss.interpolator=null"],
        ["loss.scalarisation.tie_break=0.01"],
        ["replay.relabel.share=0"],
        ["env.scenes.num_boxes=0"],
        ["objectives=[baseline]", "+objectives.calm={_target_: morlnav.navigation.envs.Efficiency}"],
        ["objectives=[distance,efficiency]"],
        ["recipe=analytical"],
        ["recipe=paper", "trainer.total_frames=12", "trainer.random_frames=6", "replay.capacity=1000"],
    ],
    ids=" ".join,
)
def test_parts_swap_by_one_word(overrides, tmp_path):
    train_briefly(tmp_path, *overrides)


@pytest.mark.parametrize("preferences", ["corners", "dirichlet", "uniform", "segments", "grid", "fixed"])
def test_a_single_objective_has_one_preference(preferences, tmp_path):
    value = ["preferences.value=[1.0]"] * (preferences == "fixed")
    trainer, _ = train_briefly(tmp_path, "objectives=[baseline,distance]", f"preferences={preferences}", *value)
    stored = trainer.replay_buffer.storage[:]
    assert stored["next", "reward"].shape[-1] == 2
    torch.testing.assert_close(stored["preference"], torch.ones(32, 1))


def test_a_single_objective_runs_to_the_end(tmp_path):
    table = run(configure(*BRIEF, "objectives=[baseline,distance]"), tmp_path)
    assert table.startswith("| distance | SR % |")
    assert morlnav.load(tmp_path).objectives == ("distance",)


def test_an_objective_of_the_users_own_needs_no_change_in_the_package(tmp_path, monkeypatch):
    (tmp_path / "my_rewards.py").write_text(
        "class Calm:\n"
        "    def __init__(self, penalty):\n"
        "        self.penalty = penalty\n\n"
        "    def __call__(self, transition):\n"
        "        return self.penalty * transition.action[..., 1].abs()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    calm = ["+objectives.calm._target_=my_rewards.Calm", "+objectives.calm.penalty=-2.0"]
    trainer, losses = train_briefly(tmp_path / "run", *calm)
    stored = trainer.replay_buffer.storage[:]
    assert stored["preference"].shape == (32, 3)
    torch.testing.assert_close(stored["next", "reward"][:, 3], -2 * stored["action"][:, 1].abs())
    assert losses[-1]["pred_value"].shape == (4,)


def test_without_the_human_in_view_the_networks_shrink(tmp_path):
    trainer, _ = train_briefly(tmp_path, "ablation=no_human")
    assert trainer.replay_buffer.storage[:]["observation"].shape == (32, 32)


@pytest.mark.parametrize(
    ("override", "gamma"), [("ablation=gamma_099", 0.99), ("ablation=gamma_095", 0.95), ("loss.gamma=0.98", 0.98)]
)
def test_the_discount_ends_where_the_config_says(override, gamma, tmp_path):
    trainer, _ = train_briefly(tmp_path, override)
    assert trainer.loss_module.value_estimator.gamma.item() == pytest.approx(gamma)


def test_discounts_may_differ_between_the_entries_of_the_reward(tmp_path):
    words = [
        "loss.gamma.baseline=0.98",
        "loss.gamma.default=0.97",
        "loss.gamma.distance=0.99",
        "~loss.gamma.efficiency",
    ]
    trainer, _ = train_briefly(tmp_path, *words)
    torch.testing.assert_close(trainer.loss_module.value_estimator.gamma, torch.tensor([0.98, 0.99, 0.97]))


def test_scales_tie_breaks_and_reward_bounds_follow_the_objectives_of_the_config(tmp_path):
    trainer, _ = train_briefly(
        tmp_path,
        "loss.scalarisation.scale={default: 1.0, distance: 0.7, efficiency: 1.2}",
        "loss.scalarisation.tie_break={default: 0.0, efficiency: 0.2}",
    )
    loss = trainer.loss_module
    torch.testing.assert_close(loss.scalarisation.scale, torch.tensor([0.7, 1.2]))
    torch.testing.assert_close(loss.scalarisation.tie_break, torch.tensor([0.0, 0.2]))
    torch.testing.assert_close(loss.return_bounds.high[1:], torch.tensor([0.0, -0.1]))  # in the learner's unit


@pytest.mark.parametrize("world", ["tensor", "pymunk"])
def test_a_robot_grazes_a_box_while_it_learns_and_passes_it_when_evaluated(world, tmp_path):
    trainer = trainer_for(configure(f"world={world}", "trainer.inflation=0.04"), tmp_path)
    learned, measured = trainer.collector.env.base_env.world, trainer._modules["evaluate_policy"].env.world
    box = torch.tensor([[[1.0, 0.7, 0.5, 0.5, 0.0]]])  # its side is 0.2 m from the way
    scene = Scene(torch.zeros(1, 3), torch.tensor([[9.0, 0.0]]), torch.tensor([[5.0, 2.0]]), box, batch_size=[1])
    touched = []
    for robots in (learned, measured):
        robots.reset(scene)
        contacts = [robots.step(torch.tensor([[0.5, 0.0]])).box for _ in range(20)]
        touched.append(bool(torch.stack(contacts).any()))
    assert touched == [True, False]


class Crawler:
    """A robot of another kind, which is no dataclass."""

    def __init__(self, radius, max_speed, max_turn):
        self.radius, self.max_speed, self.max_turn = radius, max_speed, max_turn

    action_low, action_high = DifferentialDrive.action_low, DifferentialDrive.action_high
    limit, move = DifferentialDrive.limit, DifferentialDrive.move


def test_a_robot_of_another_kind_is_wider_while_it_learns(tmp_path):
    cfg = configure(f"world.robot._target_={__name__}.Crawler", "trainer.inflation=0.04")
    trainer = trainer_for(cfg, tmp_path)
    worlds = trainer.collector.env.base_env.world, trainer._modules["evaluate_policy"].env.world
    assert [world.robot.radius for world in worlds] == pytest.approx([0.22, 0.18])


def test_a_discount_that_is_missing_is_named(tmp_path):
    cfg = configure(*(f"~loss.gamma.{name}" for name in ("default", "baseline", "efficiency")))
    with pytest.raises(ValueError, match=r"loss\.gamma names no value for baseline, efficiency, and no default"):
        trainer_for(cfg, tmp_path)


def test_learning_rates_fall_to_their_end_with_the_last_update(tmp_path):
    cfg = configure("trainer.total_frames=128", "trainer.random_frames=0", "trainer.lr_decay_end=0.1")
    trainer = trainer_for(cfg, tmp_path)
    trainer.train()
    rates = [
        optimizer["param_groups"][0]["lr"] for key, optimizer in learned(trainer)["stepper"].items() if "opt" in key
    ]
    assert rates == pytest.approx([0.1 * cfg.trainer.optimizer_actor.lr, 0.1 * cfg.trainer.optimizer_critic.lr])


def test_stored_rewards_are_raw_and_the_learners_are_scaled(tmp_path):
    trainer, _ = train_briefly(tmp_path, "replay.reward_scale=0.5")
    assert (trainer.replay_buffer.storage[:]["next", "reward"][:, 2] == -10).all()
    assert (trainer.replay_buffer.sample()["next", "reward"][:, 2] == -5).all()


# Mistakes


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("loss.angle=wrong", "loss.angle must be one of none, safe, paper, got wrong."),
        ("loss.loss_function=wrong", "loss_function must be one of l2, l1, smooth_l1, got wrong."),
        ("trainer.frames_per_batch=100", r"frames_per_batch \(100\) must be a multiple of env.num_envs \(16\)."),
        ("objectives=[distance,baseline]", "Static objectives must come before tuneable ones"),
        ("preferences=fixed", "Missing mandatory value: preferences.value"),
        ("device=nowhere", "device=nowhere cannot be used on this machine"),
        ("env.num_envs=0", "env.num_envs must be a whole number of at least 1, got 0"),
        ("env.num_envs=many", "env.num_envs must be a whole number of at least 1, got many"),
        ("trainer.policy_update_delay=0", "trainer.policy_update_delay must be a whole number of at least 1, got 0"),
        ("trainer.optim_steps_per_batch=0", "trainer.optim_steps_per_batch must be a whole number of at least 1"),
        ("trainer.exploration.sigma_init=0.05", r"must not grow, but sigma_init is 0\.05 and sigma_end 0\.1"),
        ("threads=0", "needs at least one thread, got threads=0"),
        ("trainer.inflation=-0.01", "trainer.inflation must not be negative, got -0.01"),
        ("env.scenes.band=-1", "band must not be negative, got -1"),
        ("trainer.compile=true", "trainer.compile must be null or arguments of torch.compile, .* got True."),
        ("trainer.compile={mode:wrong}", "trainer.compile must be null or arguments of torch.compile, .* got .*wrong"),
    ],
)
def test_a_wrong_value_ends_in_one_sentence(override, sentence, tmp_path):
    with pytest.raises(SystemExit, match=sentence) as error, morlnav.commands.train.one_sentence_errors():
        run(configure(override), tmp_path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("loss.angle=wrong", ["loss.angle must be one of none, safe, paper, got wrong."]),
        ("world=nosuch", ["There is no world/nosuch; choose from: pymunk, ", "tensor"]),
        ("trainer.batchsize=3", ["There is no batchsize in trainer; choose from: ", "batch_size"]),
        ("nosuch=3", ["There is no nosuch in the config; choose from: world, "]),
        ("resume=nowhere", ["resume=nowhere: no run of morlnav-train there."]),
    ],
)
def test_the_command_line_names_a_mistake_and_the_choices(override, words, train_command, tmp_path, capfd):
    with pytest.raises(SystemExit) as error:
        train_command(*SMALL, f"hydra.run.dir='{tmp_path}'", override)
    assert error.value.code not in (0, None)
    text = capfd.readouterr().err + str(error.value)
    assert "Traceback" not in text
    for word in words:
        assert word in text
