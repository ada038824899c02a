"""A run directory says what was trained, as plain text that is taken as it is."""

import pytest
import torch
from support import configure

from morlnav.navigation.demonstrations import record_demonstrations, save_demonstrations
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import SceneSampler
from morlnav.runs import Run, load_config
from morlnav.runs.directory import timed, times_of
from morlnav.runs.run import prepare
from morlnav.trainers import Training


def test_a_run_is_all_that_was_trained(kept_run):
    run = Run(kept_run)
    assert isinstance(run.training, Training)
    assert run.policy.objectives == run.evaluation.objectives == ("demo", "distance", "efficiency")
    assert run.evaluation.rewards[0] == "baseline"
    assert list(run.learned) == list(run.evaluation.demonstrators) == ["demo"]


def test_a_run_is_measured_on_the_cpu_wherever_it_was_trained(kept_run, change_config):
    change_config("device", "cuda:7")
    assert Run(kept_run).evaluation.env.device == torch.device("cpu")


def test_the_evaluation_may_be_changed(kept_run):
    evaluation = Run(kept_run, changes={"episodes": 3, "steps": None}).evaluation
    assert (evaluation.episodes, evaluation.steps) == (3, 10)


@pytest.mark.parametrize(
    "value",
    ["${oc.env:HOME}", "${oc.decode:'{_target_: os.system}'}", "a ${seed} b", "${nothing", ["${seed}"]],
    ids=str,
)
def test_an_interpolation_is_refused_and_not_resolved(kept_run, change_config, value):
    change_config("env.world.robot", value)
    with pytest.raises(ValueError, match="holds no interpolation"):
        Run(kept_run, trust=True)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("objectives: [", r"config\.yaml is damaged: it is no YAML"),
        ("a: !!python/object/apply:os.system [exit]", r"config\.yaml is damaged: it is no YAML"),
        ("", r"config\.yaml is damaged: it maps no keys to values"),
        ("12", "maps no keys to values"),
        ("[seed, 0]", "maps no keys to values"),
        ("_target_: morlnav.trainers.Training", r"config\.yaml is damaged: it names no evaluation"),
        ("{_target_: morlnav.trainers.Training, evaluation: 3}", "it names no evaluation"),
        ("{_target_: morlnav.trainers.Fit, evaluation: {}}", r"evaluation is no argument of morlnav\.trainers\.Fit"),
    ],
)
def test_a_damaged_config_is_named_in_one_sentence(kept_run, text, sentence):
    (kept_run / "config.yaml").write_text(text)
    with pytest.raises(ValueError, match=sentence) as error:
        _ = Run(kept_run).evaluation
    assert "\n" not in str(error.value)


def test_bytes_are_no_config(kept_run):
    (kept_run / "config.yaml").write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match="it is no YAML"):
        load_config(kept_run)


def test_where_there_is_no_run_it_is_said(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"is not a run directory: it holds no config\.yaml"):
        Run(tmp_path)


def test_a_reward_of_another_config_is_refused(kept_run, change_config):
    change_config("rewards.ranking.snippet", 10)
    with pytest.raises(ValueError, match=r"reward\.pt was learned by another config than that of this run"):
        _ = Run(kept_run).learned


def test_a_run_without_its_clone_is_measured_and_does_not_learn_on(kept_run, train_command):
    assert Run(kept_run).learned["demo"].clone is None
    (kept_run / "checkpoints" / "checkpoint-000000000512").mkdir(parents=True)
    with pytest.raises(SystemExit, match=rf"{kept_run} keeps no clone\.pt of demo, which learning needs"):
        train_command(f"resume={kept_run}")


def test_where_nobody_can_be_asked_the_clone_is_needed(kept_run, change_config, tmp_path):
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(distance=(5.0, 6.0)), 1, num_envs=4)
    save_demonstrations(data, tmp_path / "mine")
    folder = "morlnav.navigation.demonstrations.RecordedFolder"
    change_config("rewards.demonstrations.demo", {"_target_": folder, "path": str(tmp_path / "mine")})
    run = Run(kept_run)
    pipeline = run.training.pipeline()
    pipeline.stages["demo"].config = None  # its reward is that of another recording
    with pytest.raises(FileNotFoundError, match=r"clone\.pt"):
        pipeline.restore(kept_run)


@pytest.mark.parametrize("name", ["policy.pt", "reward.pt"])
@pytest.mark.parametrize("damage", ["a weight", "cut", "empty"])
def test_changed_weights_are_named(kept_run, name, damage):
    file = kept_run / name
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes({"a weight": content, "cut": content[: len(content) // 2], "empty": b""}[damage])
    with pytest.raises(ValueError, match=rf"{name} is damaged: it does not hold the weights that were saved"):
        _ = Run(kept_run).policy, Run(kept_run).learned


def test_one_thread_computes_unless_more_are_asked_for():  # a second one is slow on busy machines
    prepare(configure("threads=2"))
    assert torch.get_num_threads() == 2
    prepare(configure())
    assert torch.get_num_threads() == 1


def test_times_of_parts_add_up_where_they_go_on(tmp_path):
    (tmp_path / "times.json").write_text('{"learning": 100.0, "refinement": 50.0, "lunch": 9.0}')
    with timed(tmp_path, "learning", goes_on=True) as note:
        note()
        assert 100 <= times_of(tmp_path)["learning"] < 110  # whoever is killed now has this
    with pytest.raises(KeyboardInterrupt), timed(tmp_path, "refinement"):
        raise KeyboardInterrupt
    assert times_of(tmp_path)["refinement"] < 10
    assert set(times_of(tmp_path)) == {"learning", "refinement"}


@pytest.mark.parametrize("text", ["", "[]", "3", '{"learning": "long"}', '{"learning": null}'])
def test_damaged_times_are_none(tmp_path, text):
    (tmp_path / "times.json").write_text(text)
    assert times_of(tmp_path) == {}


def test_times_that_cannot_be_written_stop_nothing(tmp_path):
    (tmp_path / "times.json").mkdir()
    with timed(tmp_path, "learning"):
        pass
