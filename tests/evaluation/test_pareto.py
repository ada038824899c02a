import time

import pytest
import torch

from morlnav.evaluation import expected_utility, hypervolume, pareto_mask, utility
from morlnav.objectives import LinearScalarisation


def test_dominated_points_are_filtered_and_equal_ones_kept():
    points = torch.tensor([[1.0, 3.0], [2.0, 2.0], [1.0, 2.0], [2.0, 2.0], [3.0, 0.0]])
    assert pareto_mask(points).tolist() == [True, True, False, True, True]


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([[2.0]], 3.0),
        ([[0.0, 1.0], [1.0, 0.0]], 3.0),  # two 1 x 2 boxes that share a unit square
        ([[1.0, 1.0], [0.0, 0.0]], 4.0),  # the dominated point adds nothing
        ([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], 4.0),  # a unit cube with three arms
        ([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]], 7.0),  # a cube of side 2 without one corner
        ([[-1.0, 5.0]], 0.0),  # on the reference: nothing dominated
    ],
)
def test_hypervolume_by_hand(points, expected):
    points = torch.tensor(points)
    assert hypervolume(points, torch.full((points.shape[1],), -1.0)) == pytest.approx(expected)


@pytest.mark.parametrize("num_objectives", [2, 3, 4])
def test_hypervolume_agrees_with_throwing_darts(num_objectives):
    generator = torch.Generator().manual_seed(num_objectives)
    points = torch.rand(25, num_objectives, generator=generator)
    darts = torch.rand(40_000, num_objectives, generator=generator)
    share = (darts[:, None] <= points).all(-1).any(-1).double().mean().item()
    assert hypervolume(points, torch.zeros(num_objectives)) == pytest.approx(share, abs=0.01)


def test_hypervolume_of_a_large_front_takes_no_time():
    angles = torch.rand(60, 3, generator=torch.Generator().manual_seed(0)).abs() + 0.05
    front = angles / angles.norm(dim=-1, keepdim=True)
    assert 0.3 < hypervolume(front, torch.zeros(3)) < torch.pi / 6


def test_expected_utility_by_hand():
    returns = torch.tensor([[100.0, -10.0, -50.0], [80.0, -30.0, -20.0]])
    preferences = torch.tensor([[1.0, 0.0], [0.25, 0.75]])
    assert expected_utility(returns, preferences) == pytest.approx(((100 - 10) + (80 - 7.5 - 15)) / 2)


def test_utility_may_weigh_as_the_learner_does():
    returns, preferences = torch.tensor([[100.0, -10.0, -50.0]]), torch.tensor([[0.25, 0.75]])
    learners = LinearScalarisation(scale=[2.0, 1.0], tie_break=[0.0, 0.25])
    assert utility(returns, preferences, learners).item() == pytest.approx(100 - 10 * 0.5 - 50 * 1.0)
    assert expected_utility(returns, preferences, learners) == pytest.approx(45)


def test_wrong_shapes_are_explained():
    points = torch.zeros(3, 2)
    with pytest.raises(ValueError, match=r"\[N, m\]"):
        pareto_mask(torch.zeros(3))
    with pytest.raises(ValueError, match=r"finite"):
        hypervolume(torch.tensor([[torch.nan, 1.0]]), torch.zeros(2))
    with pytest.raises(ValueError, match="reference point"):
        hypervolume(points, torch.zeros(3))
    with pytest.raises(ValueError, match="Preferences"):
        expected_utility(points, torch.zeros(2, 2))
    with pytest.raises(ValueError, match="Preferences"):
        expected_utility(points, torch.zeros(3, 3))


@pytest.mark.parametrize("num_objectives", [1, 2, 3, 4, 6])
def test_hypervolume_agrees_with_another_library(num_objectives):
    indicators = pytest.importorskip("morl_baselines.common.performance_indicators")
    points = torch.randn(20, num_objectives, generator=torch.Generator().manual_seed(num_objectives))
    reference = torch.full((num_objectives,), -1.0)
    theirs = indicators.hypervolume(reference.double().numpy(), list(points.double().numpy()))
    assert hypervolume(points, reference) == pytest.approx(theirs)
    assert theirs > 0


def test_a_front_of_many_points_and_objectives_is_measured_at_once():
    points = torch.rand(141, 7, generator=torch.Generator().manual_seed(0))
    start = time.perf_counter()
    assert 0 < hypervolume(points, torch.zeros(7)) < 1
    assert time.perf_counter() - start < 10


def test_utility_follows_the_scalarisation_of_the_loss():
    returns, preferences = torch.tensor([[100.0, -10.0, -50.0]]), torch.tensor([[1.0, 0.0]])
    scalarisation = LinearScalarisation(scale=0.5, tie_break=0.1)
    assert expected_utility(returns, preferences, scalarisation) == pytest.approx(100 - 0.6 * 10 - 0.1 * 50)
