"""Collection by Ray actors on clusters of this machine."""

import os
import signal
import tempfile
from pathlib import Path

import psutil
import pytest
import torch
from omegaconf import OmegaConf
from support import configure, trainer_for

from morlnav.commands.train import run

ray = pytest.importorskip("ray")
QUIET = ("exploration.sigma_init=0", "exploration.sigma_end=0", "collector.init_random_frames=0")


def test_a_run_of_asynchronous_workers_starts_a_cluster_and_stops_it(tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_worker_niceness", "0")  # or workers get little of a busy machine
    with tempfile.TemporaryDirectory() as cluster:  # short, for names of sockets are
        words = ["collector.sync=false", "collector.num_collectors=1", "evaluation.episodes=2"]
        words += [f"+collector.ray_init_config._temp_dir={cluster}"]
        run(configure("collector=ray", *words), tmp_path)
        assert (tmp_path / "policy.pt").is_file()
        assert (Path(cluster) / "session_latest").is_dir()
        assert not ray.is_initialized()
        assert not [process for process in psutil.process_iter(["cmdline"]) if cluster in str(process.info["cmdline"])]


@pytest.fixture(scope="module")
def cluster():
    """Started as the config says, once for all trainings, for that takes seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_worker_niceness", "0")
        ray.init(**OmegaConf.to_container(configure("collector=ray").collector.ray_init_config, resolve=True))
    yield
    ray.shutdown()


@pytest.mark.usefixtures("cluster")
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


def test_without_ray_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr("morlnav.trainers.ray.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'morlnav\[ray\]'"):
        trainer_for(configure("collector=ray"), tmp_path)
