"""Collection by other processes: the same training, with weights that follow the learner."""

import importlib.util

import pytest
import torch
from support import configure, trainer_for

from morlnav.train import run

BACKENDS = [
    "processes",
    pytest.param(
        "ray", marks=pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed")
    ),
]


@pytest.mark.parametrize("backend", BACKENDS)
def test_workers_act_with_the_learners_weights(backend, tmp_path):
    quiet = ["trainer.exploration.sigma_init=0", "trainer.exploration.sigma_end=0", "trainer.random_frames=0"]
    trainer = trainer_for(configure(f"collector={backend}", "trainer.total_frames=96", *quiet), tmp_path)
    actor, apart = trainer.optimization_stepper.actor, []

    def compare(batch):
        with torch.no_grad():
            action = actor(batch["observation"], batch["preference"])
        apart.append((action - batch["action"]).abs().max().item())
        return batch

    trainer.register_op("batch_process", compare)
    before = [parameter.clone() for parameter in actor.parameters()]
    try:
        trainer.train()
    finally:
        trainer.collector.shutdown()
    assert len(apart) == 6
    assert max(apart) < 1e-5
    assert any((old != new).any() for old, new in zip(before, actor.parameters(), strict=True))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_whole_run_with_workers(backend, tmp_path):
    run(configure(f"collector={backend}", "evaluation.episodes=2"), tmp_path)
    assert (tmp_path / "policy.pt").is_file()


def test_asynchronous_workers_train(tmp_path):
    run(configure("collector=processes", "collector.sync=false", "evaluation.episodes=2"), tmp_path)
    assert (tmp_path / "policy.pt").is_file()


def test_environments_must_divide_among_workers(tmp_path):
    with pytest.raises(ValueError, match="must be a multiple of 3 collectors"):
        trainer_for(configure("collector=processes", "collector.num_collectors=3"), tmp_path)
