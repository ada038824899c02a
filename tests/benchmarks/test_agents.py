"""morl-baselines' agents train on our Gymnasium environment, and their policies get our report."""

import json

import pandas as pd
import pytest
import torch

from morlnav.navigation.envs import default_objectives

pytest.importorskip("morl_baselines")
from benchmarks.peers import agents


@pytest.mark.parametrize("name", ["capql", "gpi_ls"])
def test_they_train_and_are_evaluated_in_our_scenes(name, tmp_path):
    # Small networks and an early start: a second is enough for updates.
    small = {"net_arch": [32, 32], "batch_size": 16, "learning_starts": 20}
    objectives = default_objectives()
    agent, record = agents.train(name, 1.0, objectives, **small)
    assert record["environment_steps"] > 40
    assert agent.global_step == record["environment_steps"] + 1
    table = agents.evaluate(agents.Policy(agent, len(objectives)), objectives, tmp_path / "evaluation", 2, 1)
    assert "hypervolume" in table
    assert len(pd.read_csv(tmp_path / "evaluation" / "episodes.csv")) == 2 * 2
    json.dumps(record)
    agents.main(["compare", str(tmp_path), "--output", str(tmp_path / "peers")])
    assert (tmp_path / "peers" / "comparison.md").read_text().count("\n") == 3


def test_static_objectives_weigh_as_much_as_all_others():
    class Recorder:
        def eval(self, observation, weights, torch_action):
            self.observation, self.weights = observation, weights

    agent = Recorder()
    agents.Policy(agent, 3)(torch.zeros(5, 34), torch.tensor([0.25, 0.75]).expand(5, 2))
    assert agent.weights[0].tolist() == [0.5, 0.125, 0.375]
    assert agent.observation.shape == (5, 68)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["capql", "--minutes", "0"], "Needed are minutes > 0"),
        (["compare"], "compare needs run directories"),
        (["compare", "nowhere"], "nowhere/evaluation/summary.csv"),
    ],
)
def test_what_cannot_be_measured_is_refused_in_one_sentence(words, sentence, tmp_path):
    with pytest.raises(SystemExit, match=sentence):
        agents.main([*words, "--output", str(tmp_path)])
