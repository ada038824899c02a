"""morl-baselines' agents train on our Gymnasium environment, and their policies get our report."""

import json
import runpy
from pathlib import Path

import pandas as pd
import pytest

pytest.importorskip("morl_baselines")
EXAMPLE = runpy.run_path(str(Path(__file__).parents[1] / "examples" / "capql_gpi_ls.py"))


@pytest.mark.parametrize("name", ["capql", "gpi_ls"])
def test_they_train_and_are_evaluated_in_our_scenes(name, tmp_path):
    # Small networks and an early start: a second is enough for updates.
    small = {"net_arch": [32, 32], "batch_size": 16, "learning_starts": 20}
    objectives = EXAMPLE["default_objectives"]()
    agent, record = EXAMPLE["train"](name, 1.0, objectives, **small)
    assert record["environment_steps"] > 40
    assert agent.global_step == record["environment_steps"] + 1
    table = EXAMPLE["evaluate"](EXAMPLE["Policy"](agent, len(objectives)), objectives, tmp_path / "evaluation", 2, 1)
    assert "hypervolume" in table
    assert len(pd.read_csv(tmp_path / "evaluation" / "episodes.csv")) == 2 * 2
    json.dumps(record)
    EXAMPLE["main"](["compare", str(tmp_path), "--output", str(tmp_path / "peers")])
    assert (tmp_path / "peers" / "comparison.md").read_text().count("\n") == 3


def test_static_objectives_weigh_as_much_as_all_others():
    import torch

    class Recorder:
        def eval(self, observation, weights, torch_action):
            self.observation, self.weights = observation, weights

    agent = Recorder()
    EXAMPLE["Policy"](agent, 3)(torch.zeros(5, 34), torch.tensor([0.25, 0.75]).expand(5, 2))
    assert agent.weights[0].tolist() == [0.5, 0.125, 0.375]
    assert agent.observation.shape == (5, 68)
