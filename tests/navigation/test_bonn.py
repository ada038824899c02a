"""The data set of Bonn: pairs of drives by folder, answers by participant and interface."""

import os
import pickle
from collections import OrderedDict

import numpy as np
import pandas as pd
import pytest
import torch
from support import DEMONSTRATED, configure

from morlnav.navigation.bonn import BonnComparisons, read_bonn
from morlnav.navigation.world import DifferentialDrive, Lidar, TensorWorld
from morlnav.runs import make_training

WORLD = {"robot": DifferentialDrive(max_speed=1.0), "lidar": Lidar(sectors=60, max_range=6.0)}
ROUTE = "/home/somebody/study/dataset_2024"


def a_drive(near, steps=7):
    """A drive as the study kept it, this near to the human."""
    task = np.array([5.0, 0.1, near, -0.4, 0.5, 0.0])
    states = [OrderedDict(task_obs=task - 0.1 * i, scan=np.full(60, 0.5, np.float32)) for i in range(steps + 1)]
    actions = [np.array([0.6, -0.2], np.float32) for _ in range(steps)]
    return {"states": states, "actions": actions, "rewards": [np.float64(0.5)] * steps, "infos": [{}] * steps}


@pytest.fixture
def study(tmp_path):
    """Two trials, in which A passes nearer than B, and what two people said of them."""
    for trial in (3, 8):
        folder = tmp_path / "dataset_2024" / f"Trial_{trial}"
        folder.mkdir(parents=True)
        for letter, near in (("A", 1.0), ("B", 2.0)):
            (folder / f"Query_{letter}_state_action_reward.pkl").write_bytes(pickle.dumps(a_drive(near, 7 + trial)))
    (tmp_path / "user_feedback_data").mkdir()
    answer(tmp_path, 1, "VR", [-1, 0, 1], "ABB", [3, 3, 8])
    answer(tmp_path, 1, "2D_TD", [0], "A", [3])
    answer(tmp_path, 27, "VR", [0], "A", [8])
    return tmp_path


def answer(study, person, interface, numbers, preferred, trials):
    table = {"TrialNumber": numbers, "Preference": list(preferred), "id": trials}
    table["data_path"] = [f"{ROUTE}/Trial_{trial}/" for trial in trials]
    file = study / "user_feedback_data" / f"user_study_results_id_{person}_block_{interface}.csv"
    pd.DataFrame(table).to_csv(file, index=False)


def test_who_saw_what_through_which_interface_and_liked_which(study):
    comparisons, data = read_bonn(study)
    assert [row.preferred for row in comparisons] == ["first", "second", "second"]
    assert data["episode"].unique().numel() == 4
    nearest = [data["observation"][data["episode"] == row.first.episode][0, 2] for row in comparisons]
    assert nearest == pytest.approx([1.0, 1.0, 1.0])
    torch.testing.assert_close(data["observation"][0, [0, 1, 3, 4]], torch.tensor([5.0, 0.1, -0.4, 3.0]))
    assert data["observation"].shape[1] == 64
    assert [len(read_bonn(study, interface)[0]) for interface in ("VR", "2D_TD")] == [2, 1]
    assert len(read_bonn(study, skip=())[0]) == 4


def test_a_reward_may_learn_from_it(study):
    pairs = BonnComparisons(str(study), "VR", world=TensorWorld(**WORLD))
    assert pairs.sample()["better", "observation"][:, 0, 2].tolist() == pytest.approx([2.0] * 16)
    assert BonnComparisons(str(study), "VR", observe_human=False).snippets["observation"].shape[-1] == 62
    assert pairs.key != BonnComparisons(str(study)).key
    with pytest.raises(ValueError, match=r"the world has 30, 4 and 0.5; set env.world.lidar.sectors=60"):
        BonnComparisons(str(study), world=TensorWorld())


def test_the_command_line_learns_from_it(study, tmp_path):
    world = ["env.world.lidar.sectors=60", "env.world.lidar.max_range=6", "env.world.robot.max_speed=1"]
    small = ["rewards.num=2", "rewards.audit=null", f"cache={tmp_path / 'cache'}", "rewards.ranking.snippet=3"]
    small += ["rewards.ranking.fit={steps:4,interval:2}", "rewards.clone.fit.steps=4", "rewards.ranking.episodes=2"]
    words = ["ranking=bonn", f"rewards.ranking.comparisons.path={study}", *world, *small]
    reward = make_training(configure(DEMONSTRATED, *words)).learn_rewards()["demo"].transform
    assert reward.reward(torch.rand(5, 64), torch.rand(5, 2)).isfinite().all()


class Hostile:
    def __reduce__(self):
        return os.mkdir, ("hostile",)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (a_drive(1.0) | {"infos": [Hostile()]}, None),
        (a_drive(1.0) | {"states": Hostile()}, "is no drive of this study"),
        (
            a_drive(1.0) | {"actions": [[0.1, 0.1]] * 9},
            r"task_obs: expected finite numbers \[9, 6\], got \[8",
        ),
        (a_drive(np.nan), r"states.task_obs: expected finite numbers"),
        (a_drive(1.0) | {"actions": [[3.0, 0.1]] * 7}, "speeds up to 1 m/s"),
        ({"states": []}, "is no drive of this study: KeyError: 'actions'"),
    ],
)
def test_no_code_runs_and_what_is_no_drive_is_named(study, content, words, monkeypatch):
    monkeypatch.chdir(study)
    file = study / "dataset_2024" / "Trial_8" / "Query_A_state_action_reward.pkl"
    file.write_bytes(pickle.dumps(content))
    if words is None:
        read_bonn(study)
    else:
        with pytest.raises(ValueError, match=words) as error:
            read_bonn(study)
        assert str(file) in str(error.value)
    assert not (study / "hostile").exists()


def test_a_copy_of_the_answers_does_not_count_twice(study):
    answers = study / "user_feedback_data" / "user_study_results_id_1_block_VR.csv"
    for name in (" (1)", "_copy", ""):
        copy = answers.with_name(f"{answers.stem}{name}.csv")
        copy.write_bytes(answers.read_bytes())
        if name:
            with pytest.raises(ValueError, match="has no name of this study; is it a copy"):
                read_bonn(study)
            copy.unlink()
    assert len(read_bonn(study)[0]) == 3


def test_what_is_missing_or_unreadable_is_named(study):
    file = study / "dataset_2024" / "Trial_8" / "Query_B_state_action_reward.pkl"
    whole = file.read_bytes()
    for cut in (0, 10, len(whole) // 2):
        file.write_bytes(whole[:cut])
        with pytest.raises(ValueError, match=r"Query_B_state_action_reward.pkl is no drive of this study"):
            read_bonn(study)
    file.unlink()
    with pytest.raises(FileNotFoundError, match=r"block_VR.csv, row 4: there is no .*Query_B_state_action_reward.pkl"):
        read_bonn(study)
    with pytest.raises(ValueError, match="no interface 3D; choose from: VR"):
        read_bonn(study, "3D")
    answer(study, 1, "VR", [0], "C", [3])
    with pytest.raises(ValueError, match=r"row 2, column Preference: expected A or B, got C"):
        read_bonn(study, "VR")
    pd.DataFrame({"x": [1]}).to_csv(study / "user_feedback_data" / "user_study_results_id_1_block_VR.csv")
    with pytest.raises(ValueError, match="expected a column TrialNumber"):
        read_bonn(study, "VR")
    with pytest.raises(FileNotFoundError, match="holds no user_feedback_data"):
        read_bonn(study / "dataset_2024")
