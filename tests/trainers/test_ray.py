"""Collection by Ray actors on a cluster that is started for the training and stopped after it."""

import os
import signal

import pytest
import torch
from support import configure, trainer_for

from morlnav.train import run

ray = pytest.importorskip("ray")
QUIET = ("trainer.exploration.sigma_init=0", "trainer.exploration.sigma_end=0", "trainer.random_frames=0")


@pytest.fixture(autouse=True)
def _full_priority(monkeypatch):
    monkeypatch.setenv("RAY_worker_niceness", "0")  # or importing PyTorch takes long on a busy machine


def test_workers_act_with_the_learners_weights_until_one_dies(tmp_path):
    trainer = trainer_for(configure("collector=ray", "trainer.total_frames=9600", *QUIET), tmp_path)
    actor, apart = trainer.optimization_stepper.actor, []
    worker = ray.get(trainer.collector.remote_collectors[0].__ray_call__.remote(lambda _: os.getpid()))

    def compare(batch):
        with torch.no_grad():
            action = actor(batch["observation"], batch["preference"])
        apart.append((action - batch["action"]).abs().max().item())
        if len(apart) == 6:
            os.kill(worker, signal.SIGKILL)
        return batch

    trainer.register_op("batch_process", compare)
    before = [parameter.clone() for parameter in actor.parameters()]
    with pytest.raises(ChildProcessError, match="A collecting process died"):
        trainer.train()
    assert len(apart) == 6
    assert max(apart) < 1e-5
    assert any((old != new).any() for old, new in zip(before, actor.parameters(), strict=True))
    assert not ray.is_initialized()  # the cluster is gone


def test_asynchronous_workers_train(tmp_path):
    run(configure("collector=ray", "collector.sync=false", "evaluation.episodes=2"), tmp_path)
    assert (tmp_path / "policy.pt").is_file()
    assert not ray.is_initialized()


def test_without_ray_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr("morlnav.trainers.ray.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'morlnav\[ray\]'"):
        trainer_for(configure("collector=ray"), tmp_path)
