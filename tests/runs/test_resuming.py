"""Outputs belong to one run: a start that is refused changes nothing, and no stranger's code runs on resuming."""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
import torch
import yaml
from omegaconf import OmegaConf
from support import BRIEF, DEMONSTRATED, SINGLE, SMALL, assert_identical, configure

import morlnav
from morlnav.commands.evaluate import evaluate_run
from morlnav.commands.train import main, run
from morlnav.modules import read_facts
from morlnav.runs import Run
from morlnav.runs.directory import reserved
from morlnav.trainers import Training

TINY = (
    "trainer.total_frames=64",
    "trainer.checkpoint_interval=32",
    "collector.init_random_frames=32",
    "hooks.evaluate.interval=64",
    "hooks.fit_interpolator.interval=64",
    "transforms.time_limit.max_steps=50",
)
WORDS = (*SMALL, SINGLE, *TINY, "evaluation.episodes=2", "evaluation.steps=1")


def contents(directory):
    """Every file below a directory, with the hash of its bytes."""
    return {
        str(path.relative_to(directory)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
        for path in directory.rglob("*")
    }


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    directory = tmp_path_factory.mktemp("made") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["morlnav-train", *WORDS, f"hydra.run.dir='{directory}'"])
        patch.setenv("HYDRA_FULL_ERROR", "")
        patch.delenv("HYDRA_FULL_ERROR")
        patch.syspath_prepend(directory.parent)
        main()
    return directory


@pytest.fixture
def finished(made, tmp_path):
    """A finished run of the command line, to be changed by the test."""
    return shutil.copytree(made, tmp_path / "run")


def begun_with(run, *words):
    """Add words to those that a run says it began with."""
    path = run / ".hydra" / "overrides.yaml"
    path.write_text(yaml.safe_dump([*yaml.safe_load(path.read_text()), *words]))


# A resumed run that is refused


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        ("actor.num_cells=8", r"not load with other settings \(actor\.num_cells: 32 then, 8 now\)"),
        ("seed=5", r"the run has finished, and other settings \(seed: 0 then, 5 now\) would change nothing"),
        ("loss.num_qvalue_nets=3", r"not load with other settings \(loss\.num_qvalue_nets: 2 then, 3 now\)"),
        ("trainer.batchsize=3", "There is no batchsize in trainer"),
        ("+trainer.batchsize=3", r"trainer\.batchsize is no argument of"),
        ("collector.frames_per_batch=100", r"must be a positive multiple of the 16 environments"),
        ("device=nowhere", "device=nowhere cannot be used"),
        ("-m", "continues one run; leave out -m"),
    ],
)
def test_a_refused_resume_changes_no_byte(word, sentence, finished, train_command):
    before = contents(finished)
    with pytest.raises(SystemExit, match=sentence):
        train_command(f"resume={finished}", word)
    assert contents(finished) == before


def test_after_a_refusal_a_finished_run_is_evaluated_and_resumed(finished, train_command, capsys):
    with pytest.raises(SystemExit):
        train_command(f"resume={finished}", "actor.num_cells=8")
    evaluate_run(Run(finished), finished / "again")
    assert "2 scenes" in (finished / "again" / "table.md").read_text()
    (finished / "policy.pt").unlink()
    train_command(f"resume={finished}")
    assert "at 64 of 64 frames" in capsys.readouterr().out


def test_a_finished_run_says_so_at_once_and_changes_nothing(finished, train_command, monkeypatch, capsys):
    monkeypatch.setattr(Training, "rehearse", None)  # it is not even built
    before = contents(finished)
    train_command(f"resume={finished}", "trainer.progress_bar=true")  # on which no result depends
    told = capsys.readouterr().out
    assert f"{finished} has finished with these settings before; nothing is left to do." in told
    assert "success" in told
    assert contents(finished) == before


@pytest.mark.parametrize("lost", ["policy.pt", "policy.json", "evaluation", "a byte"])
def test_what_a_finished_run_has_lost_is_made_anew(lost, finished, made, train_command):
    if lost == "evaluation":
        shutil.rmtree(finished / lost)
    elif lost == "a byte":
        (finished / "policy.pt").write_bytes((made / "policy.pt").read_bytes()[:-1])
    else:
        (finished / lost).unlink()
    train_command(f"resume={finished}")
    assert_identical(torch.load(finished / "policy.pt"), torch.load(made / "policy.pt"))
    assert read_facts(finished / "policy.pt") == read_facts(made / "policy.pt") | {"frames": 64}
    assert (finished / "evaluation" / "table.md").read_text() == (made / "evaluation" / "table.md").read_text()


def test_a_longer_run_that_was_killed_is_not_taken_for_finished(finished, train_command, monkeypatch, capsys):
    with monkeypatch.context() as patch:
        patch.setattr(Training, "finish", lambda *_: sys.exit("killed"))
        with pytest.raises(SystemExit, match="killed"):
            train_command(f"resume={finished}", "trainer.total_frames=96")
    train_command(f"resume={finished}")
    assert "at 96 of 96 frames" in capsys.readouterr().out
    assert read_facts(finished / "policy.pt")["frames"] == 96


def test_a_finished_run_may_go_on_for_longer(finished, train_command, capsys):
    train_command(f"resume={finished}", "trainer.total_frames=96")
    assert "at 64 of 96 frames" in capsys.readouterr().out
    assert OmegaConf.load(finished / "config.yaml").trainer.total_frames == 96
    assert "trainer.total_frames=96" in OmegaConf.load(finished / ".hydra" / "overrides.yaml")
    assert list((finished / "logs").rglob("*.csv"))


@pytest.mark.parametrize("kept", ["checkpoints", ".hydra"])
def test_where_no_run_can_be_resumed_nothing_is_written(kept, finished, train_command):
    for path in (finished / "checkpoints", finished / ".hydra"):
        if path.name != kept:
            shutil.rmtree(path)
    (finished / "policy.pt").unlink()
    before = contents(finished)
    with pytest.raises(SystemExit, match=r"no checkpoint there|no run of morlnav-train there"):
        train_command(f"resume={finished}")
    assert contents(finished) == before


# Trust


@pytest.mark.parametrize(
    "word",
    [
        "+env.objectives.evil={_target_: shutil.copyfile, src: bait, dst: stolen}",
        "+env.objectives.evil={_target_: my_evil.Evil}",
        "env.objectives.baseline.terms=[{_target_: my_evil.Evil}]",
        "+rewards.clone.actor.evil={_target_: morlnav.runs.resuming.Path, _args_: [stolen]}",
        "+env.objectives.evil=\"${oc.decode:'{_target_: my_evil.Evil}'}\"",
        "+name=my_evil.Evil actor.features._target_=${name}",
        "+rewards.demonstrations.evil.policy._target_=my_evil.Evil",
        "logger={_target_: my_evil.Evil}",
        "hooks.log_episodes={_target_: my_evil.Evil}",
        "collector.backend=ray",
        "compile={options: {cpp.cxx: [my_evil]}}",
    ],
)
def test_a_strangers_run_needs_trust_and_runs_no_code_before(word, finished, train_command, tmp_path):
    (tmp_path / "bait").write_text("stolen")
    (tmp_path / "my_evil.py").write_text("open('stolen', 'w').close()\n")
    begun_with(finished, *(word.split(" ") if word.startswith("+name") else [word]))
    before = contents(finished)
    with pytest.raises(SystemExit, match=r"if it is your own, add trust=true to the command line\.$"):
        train_command(f"resume={finished}")
    assert contents(finished) == before
    assert not (tmp_path / "stolen").exists()
    assert "my_evil" not in sys.modules


@pytest.mark.parametrize(
    "word", ["hydra.callbacks.x={_target_: os.system}", "hydra/launcher=joblib", "-m", "--cfg=job"]
)
def test_words_that_no_run_keeps_are_refused_even_with_trust(word, finished, train_command):
    begun_with(finished, word)
    with pytest.raises(SystemExit, match="which no run keeps there; nothing was run"):
        train_command(f"resume={finished}", "trust=true")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{preferences: {_target_: my_evil.Evil}}", "foreign my_evil.Evil"),
        ("{hydra: {callbacks: {evil: {_target_: my_evil.Evil}}}}", "changes hydra.callbacks"),
        ("{hydra: {job: {env_set: {LD_PRELOAD: evil.so}}}}", "changes hydra.job.env_set"),
    ],
)
def test_configs_beside_a_strangers_run_need_trust(text, sentence, finished, train_command, tmp_path):
    folder = finished / "conf" / "preferences"
    folder.mkdir(parents=True)
    (folder / "evil.yaml").write_text(f"# @package _global_\n{text}\n")
    (tmp_path / "my_evil.py").write_text("open('stolen', 'w').close()\n")
    path = finished / ".hydra" / "hydra.yaml"
    settings = OmegaConf.load(path)
    settings.hydra.runtime.config_sources.append(
        {"path": str(finished / "conf"), "schema": "file", "provider": "command-line"}
    )
    OmegaConf.save(settings, path)
    begun_with(finished, "preferences=evil")
    with pytest.raises(SystemExit, match=f"{sentence}; if it is your own, add trust=true"):
        train_command(f"resume={finished}")
    assert not (tmp_path / "stolen").exists()


def test_a_package_of_configs_is_not_imported(finished, train_command, tmp_path):
    (tmp_path / "my_configs").mkdir()
    (tmp_path / "my_configs" / "__init__.py").write_text("open('stolen', 'w').close()\n")
    path = finished / ".hydra" / "hydra.yaml"
    settings = OmegaConf.load(path)
    settings.hydra.overrides.hydra.append("hydra.searchpath=[pkg://my_configs]")
    OmegaConf.save(settings, path)
    with pytest.raises(SystemExit, match=r"takes configs from pkg://my_configs; .*trust=true"):
        train_command(f"resume={finished}")
    assert not (tmp_path / "stolen").exists()


def test_trust_is_not_taken_from_the_run_itself(finished, train_command):
    begun_with(finished, "trust=true", "+env.objectives.evil={_target_: shutil.copyfile}")
    with pytest.raises(SystemExit, match=r"foreign shutil\.copyfile"):
        train_command(f"resume={finished}")


def test_ones_own_run_resumes_with_trust_time_and_again(train_command, tmp_path, capsys):
    (tmp_path / "my_calm.py").write_text(
        "class Calm:\n    def __call__(self, transition):\n        return -transition.action[..., 1].abs()\n"
    )
    train_command(*WORDS, "+env.objectives.calm={_target_: my_calm.Calm}", "hydra.run.dir=mine")
    for _ in range(2):
        with pytest.raises(SystemExit, match=r"my_calm\.Calm; if it is your own, add trust=true"):
            train_command("resume=mine")
        train_command("resume=mine", "trust=true")
        assert "nothing is left to do" in capsys.readouterr().out
    assert morlnav.load("mine", trust=True).objectives[-1] == "calm"


# One directory, one run


def test_another_run_in_the_same_directory_is_refused_before_it_writes(finished, train_command):
    before = contents(finished)
    with pytest.raises(SystemExit, match=rf"{finished} holds a run of another config \(seed: 0 then, 5 now\)"):
        train_command(*WORDS, "seed=5", f"hydra.run.dir='{finished}'")
    with pytest.raises(SystemExit, match=r"policy\.pt of this run already; continue it with resume="):
        train_command(*WORDS, f"hydra.run.dir='{finished}'")
    assert contents(finished) == before


def test_a_run_that_was_killed_before_its_first_checkpoint_begins_anew(finished):
    (finished / "policy.pt").unlink()
    shutil.rmtree(finished / "checkpoints")
    with pytest.raises(ValueError, match="holds a run of another config"):
        run(configure(*WORDS, "seed=5"), finished)
    run(configure(*WORDS), finished)
    assert (finished / "policy.pt").is_file()


def test_a_reward_without_a_config_belongs_to_nobody_and_is_left_alone(tmp_path):
    (tmp_path / "reward.pt").write_bytes(b"of somebody")
    with pytest.raises(FileNotFoundError, match=r"is not a run directory: it holds no config\.yaml"):
        run(configure(*WORDS), tmp_path)
    assert (tmp_path / "reward.pt").read_bytes() == b"of somebody"


def test_a_reward_is_used_by_the_config_that_it_was_learned_by_alone(tmp_path):
    demo = [*BRIEF, DEMONSTRATED, *TINY, "transforms.time_limit.max_steps=100", "evaluation.episodes=1"]
    began, cache = tmp_path / "run", f"cache={tmp_path / 'cache'}"
    run(configure(*demo, cache), began)
    reward, resume = read_facts(began / "reward.pt"), f"resume='{began}'"
    before = contents(began)
    for word in ("seed=5", "rewards.ranking.snippet=10"):
        with pytest.raises(ValueError, match=r"reward\.pt was learned by another config|defaults have changed"):
            run(configure(*demo, word, cache, resume), began)
    assert contents(began) == before

    (began / "policy.pt").unlink()
    run(configure(*demo, f"cache={tmp_path / 'elsewhere'}", resume), began)
    assert not (tmp_path / "elsewhere").exists()  # its own reward is enough
    assert read_facts(began / "reward.pt") == reward


def test_a_second_run_at_the_same_time_is_refused(finished, train_command):
    with reserved(finished):
        before = contents(finished)
        for words in ([f"resume={finished}", "trainer.total_frames=96"], [*WORDS, f"hydra.run.dir='{finished}'"]):
            with pytest.raises(SystemExit, match=rf"Another run is at work in {finished}; wait for it"):
                train_command(*words)
        assert contents(finished) == before
    train_command(f"resume={finished}", "trainer.total_frames=96")


@pytest.mark.parametrize("collector", ["single", "processes"])
def test_a_killed_run_leaves_no_lock_and_its_leftovers_go(collector, tmp_path, train_command, capsys):
    directory = tmp_path / "run"
    words = [*WORDS, "trainer.total_frames=100000", f"collector={collector}", f"hydra.run.dir='{directory}'"]
    command = [sys.executable, "-m", "morlnav.commands.train", *words]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        for _ in range(12000):
            if list((directory / "checkpoints").glob("checkpoint-*/manifest.json")):
                break
            assert process.poll() is None, process.communicate()[1]
            time.sleep(0.05)
        with pytest.raises(SystemExit, match="Another run is at work"):
            train_command(f"resume={directory}")
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    staged = directory / "checkpoints" / ".checkpoint-000000099999.stage-0123456789abcdef"
    (staged / "components").mkdir(parents=True)
    frames = int(max(path.name[-12:] for path in (directory / "checkpoints").glob("checkpoint-*/")))
    train_command(f"resume={directory}", f"trainer.total_frames={frames + 32}")
    assert "Continuing from" in capsys.readouterr().out
    assert not list((directory / "checkpoints").glob(".*"))
    assert not (directory / ".lock").exists()
