import pytest
import torch
from support import configure

from morlnav import load
from morlnav.modules import read_facts
from morlnav.train import run

SMALL = [
    "objectives=[baseline,demo,distance,efficiency]",
    "demonstrations.num=8",
    "clone.fit.steps=20",
    "clone.actor.num_cells=32",
    "ranking.levels=[0.0,0.9]",
    "ranking.episodes=4",
    "ranking.normalise=false",
    "ranking.fit.steps=5",
    "ranking.model.num_cells=16",
    "ranking.batch_size=4",
]


@pytest.fixture(scope="module")
def demonstration_run(tmp_path_factory):
    directory = tmp_path_factory.mktemp("demonstrations")
    cfg = configure(*SMALL, f"cache={directory / 'cache'}")
    run(cfg, directory / "run")
    return cfg, directory


def test_demonstrations_become_the_first_tuneable_objective(demonstration_run):
    _, directory = demonstration_run
    policy = load(directory / "run")
    assert policy.objectives == ("demo", "distance", "efficiency")
    assert policy(torch.zeros(34), torch.tensor([1.0, 0.0, 0.0])).shape == (2,)


def test_the_run_keeps_its_reward_model_and_may_move(demonstration_run, tmp_path):
    _, directory = demonstration_run
    assert "held_out" in read_facts(directory / "run" / "reward.pt")["facts"]
    moved = (directory / "run").rename(tmp_path / "moved")
    assert load(moved).objectives[0] == "demo"
    moved.rename(directory / "run")


def test_every_stage_is_cached_by_its_config(demonstration_run):
    _, directory = demonstration_run
    stages = {path.name.partition("-")[0] for path in (directory / "cache").iterdir()}
    assert stages == {"demonstrations", "clone", "ranking"}


def test_the_report_measures_the_distance_to_the_demonstration(demonstration_run):
    _, directory = demonstration_run
    assert "frechet" in (directory / "run" / "evaluation" / "episodes.csv").read_text().splitlines()[0]
