import ast
import inspect

import numpy as np
import pandas as pd
import pytest
import torch

from morlnav.evaluation import front as module
from morlnav.evaluation import front_table, hypervolume, read_reference, reference_from_bounds
from morlnav.evaluation.front import describe_front
from morlnav.objectives import LinearScalarisation

NAMES = ["cost", "speed", "comfort"]
PREFERENCES = torch.tensor([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])


@pytest.fixture
def returns():
    return torch.randn(3, 7, 3, generator=torch.Generator().manual_seed(0))


def test_a_table_of_any_task_holds_means_deviations_and_their_quality(returns):
    reference = torch.full((3,), -2.0)
    table = front_table(PREFERENCES, returns, NAMES, reference)
    means = returns.double().mean(1)
    np.testing.assert_allclose(table[[f"return_{name}" for name in NAMES]], means)
    np.testing.assert_allclose(table[[f"std_{name}" for name in NAMES]], returns.numpy().std(1, ddof=1), rtol=1e-6)
    expected = means[:, 0] + (means[:, 1:] * PREFERENCES).sum(-1)
    assert table["utility"].tolist() == pytest.approx(expected.tolist())
    assert table["expected_utility"].tolist() == pytest.approx([expected.mean().item()] * 3)
    assert table["hypervolume"].tolist() == pytest.approx([hypervolume(means, reference)] * 3)
    assert table["reference_speed"].tolist() == [-2.0] * 3
    assert table["lambda_comfort"].tolist() == [0.0, 0.5, 1.0]


def test_means_alone_have_no_deviations_but_the_same_front(returns):
    reference = torch.full((3,), -2.0)
    episodes, means = (
        front_table(PREFERENCES, r, NAMES, reference) for r in (returns.double(), returns.double().mean(1))
    )
    pd.testing.assert_frame_equal(means, episodes[list(means)])
    assert not [name for name in means if name.startswith("std_")]


def test_utility_has_the_weights_of_the_given_scalarisation(returns):
    table = front_table(PREFERENCES, returns, NAMES, scalarisation=LinearScalarisation(scale=2.0, tie_break=0.5))
    means = returns.double().mean(1)
    expected = means[:, 0] + (means[:, 1:] * (2 * PREFERENCES + 0.5)).sum(-1)
    assert table["utility"].tolist() == pytest.approx(expected.tolist())


def test_points_below_the_reference_are_counted():
    points = torch.tensor([[1.0, 1.0], [-1.0, 9.0], [0.0, 5.0]])
    text = describe_front(front_table(PREFERENCES, points, ["speed", "comfort"], torch.zeros(2)))
    assert "2 of 3 points lie below the reference point and add nothing." in text
    assert "hypervolume 1 above the reference point (speed 0, comfort 0)" in text


def test_the_reference_is_strictly_below_the_worst_episode():
    bounds = torch.tensor([[-10.0, 0.0, 0.5], [0.0, 2.0, 1.0]])
    worst = torch.tensor([-10.0 * 40, 0.0, 0.0])
    assert (reference_from_bounds(bounds, 40) < worst).all()


def test_a_reference_may_be_a_list_or_name_what_has_no_bounds():
    default = torch.tensor([-5.0, -torch.inf])
    assert read_reference([-1, -2.5], ["speed", "comfort"], default).tolist() == [-1.0, -2.5]
    assert read_reference({"comfort": -7}, ["speed", "comfort"], default).tolist() == [-5.0, -7.0]
    assert read_reference(None, ["speed", "comfort"], default) is default


@pytest.mark.parametrize("given", [[1.0], "abc", 3, ["a", 1.0], {"speed": None}])
def test_a_reference_that_does_not_fit_is_refused_in_one_sentence(given):
    with pytest.raises(ValueError, match=r"reference needs 2 numbers, for speed, comfort"):
        read_reference(given, ["speed", "comfort"], torch.zeros(2))
    with pytest.raises(ValueError, match=r"reference names hurry; the objectives are: speed, comfort"):
        read_reference({"hurry": 1.0}, ["speed", "comfort"], torch.zeros(2))


def test_what_does_not_fit_is_explained(returns):
    with pytest.raises(ValueError, match="3 entries, but 2 are named"):
        front_table(PREFERENCES, returns, NAMES[:2])
    with pytest.raises(ValueError, match="Preferences need the shape"):
        front_table(PREFERENCES[:2], returns, NAMES)
    with pytest.raises(ValueError, match="3 finite numbers"):
        front_table(PREFERENCES, returns, NAMES, torch.tensor([0.0, 0.0, -torch.inf]))


def test_it_knows_nothing_of_navigation():
    imports = [node for node in ast.walk(ast.parse(inspect.getsource(module))) if isinstance(node, ast.ImportFrom)]
    ours = {node.module for node in imports if node.module.startswith("morlnav")}
    assert ours == {"morlnav.evaluation.pareto"}
