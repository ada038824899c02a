"""Collection by other processes: the same training, with weights that follow the learner."""

import os
import signal
from functools import partial

import pytest
import torch
from support import ANALYTICAL, SMALL, configure, trainer_for

from morlnav.commands.train import STOP, run
from morlnav.runs import make_training
from morlnav.trainers.collectors import _make_workers_env, watched

FATAL = """
import multiprocessing, os, signal

class Fatal:
    def __init__(self):
        if multiprocessing.parent_process() is not None:
            os.kill(os.getpid(), signal.SIGKILL)

    def __call__(self, transition):
        return -transition.action[:, 1].abs()
"""


def test_workers_act_with_the_learners_weights_until_one_dies(tmp_path):
    quiet = ["exploration.sigma_init=0", "exploration.sigma_end=0", "collector.init_random_frames=0"]
    trainer = trainer_for(configure("collector=processes", "trainer.total_frames=9600", *quiet), tmp_path)
    actor, apart = trainer.optimization_stepper.actor, []

    def compare(batch):
        with torch.no_grad():
            action = actor(batch["observation"], batch["preference"])
        apart.append((action - batch["action"]).abs().max().item())
        if len(apart) == 3:
            for number in STOP:  # they may reach all processes, and are the learner's affair
                os.kill(trainer.collector.procs[0].pid, number)
        if len(apart) == 6:
            os.kill(trainer.collector.procs[0].pid, signal.SIGKILL)
        return batch

    trainer.register_op("batch_process", compare)
    before = [parameter.clone() for parameter in actor.parameters()]
    with pytest.raises(ChildProcessError, match="A collecting process died"), watched(trainer.collector):
        trainer.train()
    assert len(apart) == 6
    assert max(apart) < 1e-5
    assert any((old != new).any() for old, new in zip(before, actor.parameters(), strict=True))


def test_asynchronous_workers_train(tmp_path):
    words = ["collector=processes", "collector.sync=false", "collector.num_collectors=1", "evaluation.episodes=2"]
    run(configure(*words), tmp_path)
    assert (tmp_path / "policy.pt").is_file()


def test_an_error_of_the_learner_ends_the_workers(tmp_path):
    trainer = trainer_for(configure("collector=processes", "collector.num_collectors=1"), tmp_path)
    (worker,) = (process.pid for process in trainer.collector.procs)

    def fail(batch):
        raise ZeroDivisionError

    trainer.register_op("batch_process", fail)
    with pytest.raises(ZeroDivisionError), watched(trainer.collector):
        trainer.train()
    with pytest.raises(ProcessLookupError):
        os.kill(worker, 0)


def test_a_worker_that_dies_at_its_start_ends_the_command_with_a_clear_message(train_command, tmp_path, capfd):
    (tmp_path / "fatal.py").write_text(FATAL)
    words = ["+env.objectives.fatal._target_=fatal.Fatal", "collector=processes", "collector.num_collectors=1"]
    with pytest.raises(SystemExit, match="A collecting process died at its start"):
        train_command(*SMALL, ANALYTICAL, *words)
    assert "Traceback" not in capfd.readouterr().err


def test_environments_must_divide_among_workers(tmp_path):
    with pytest.raises(ValueError, match="must be a multiple of 3 collectors"):
        trainer_for(configure("collector=processes", "collector.num_collectors=3"), tmp_path)


def test_the_workers_segments_are_the_whole_preference_space():
    training = make_training(
        configure("collector=processes", "env.num_envs=4", "preferences=segments", "preferences.segments=4")
    )
    make_env = partial(training.make_env, {})
    envs = [_make_workers_env(make_env, share=2, worker=worker, seed=worker) for worker in range(2)]
    first = torch.cat([env.reset()["preference"][:, 0] for env in envs])
    assert (first * 4).long().sort().values.tolist() == [0, 1, 2, 3]
