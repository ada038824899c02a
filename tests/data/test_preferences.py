"""Grids of preferences are exact, and every sampler draws from the distribution that it names."""

from math import comb

import pytest
import torch
from scipy.stats import kstest

from morlnav.data import (
    CornerWeightedPreferences,
    DirichletPreferences,
    FixedPreferences,
    GridPreferences,
    SegmentedPreferences,
    UniformPreferences,
    preference_edges,
    simplex_grid,
)

SAMPLERS = [
    UniformPreferences(3),
    UniformPreferences(2),
    DirichletPreferences(3, 0.3),
    DirichletPreferences(4, [0.01, 1.0, 2.0, 5.0]),
    SegmentedPreferences(3, 3),
    SegmentedPreferences(2, 4, offset=3),
    CornerWeightedPreferences(3),
    CornerWeightedPreferences(5, 0.5, 0.5),
    FixedPreferences([0.2, 0.3, 0.5]),
    GridPreferences(3, 10),
    GridPreferences(3, 4, noise=0.05),
    UniformPreferences(1),
    DirichletPreferences(1, 0.5),
    SegmentedPreferences(1, 3),
    CornerWeightedPreferences(1),
    GridPreferences(1, 10),
]


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.mark.parametrize(("n", "steps"), [(1, 4), (2, 10), (3, 10), (4, 7), (6, 10)])
def test_the_grid_holds_every_point_once(n, steps):
    counts = simplex_grid(n, steps) * steps
    assert counts.shape == (comb(steps + n - 1, n - 1), n)
    assert torch.equal(counts, counts.round())
    assert torch.equal(counts.sum(-1), torch.full((len(counts),), float(steps)))
    assert len(counts.unique(dim=0)) == len(counts)
    assert torch.equal(counts, counts.unique(dim=0))  # lexicographic order


def test_a_grid_in_many_dimensions_needs_no_cartesian_product():
    assert simplex_grid(12, 5).shape == (4368, 12)  # out of 6^12 = 2.2e9 combinations


def test_the_edges_are_the_papers_thirty_test_preferences():
    edges = preference_edges(3, 10)
    assert edges.shape == (30, 3)
    assert len(edges.unique(dim=0)) == 30
    assert ((edges == 0).sum(-1) >= 1).all()
    torch.testing.assert_close(edges.sum(-1), torch.ones(30))


def test_the_edges_are_the_grid_points_with_at_most_two_weights():
    grid = simplex_grid(4, 5)
    border = grid[(grid > 0).sum(-1) <= 2]
    assert torch.equal(preference_edges(4, 5).unique(dim=0), border.unique(dim=0))


def test_two_objectives_have_a_line_of_eleven_points():
    torch.testing.assert_close(preference_edges(2, 10)[:, 1], torch.linspace(0, 1, 11))


@pytest.mark.parametrize("sampler", SAMPLERS, ids=lambda sampler: f"{type(sampler).__name__}{sampler.num_objectives}")
@pytest.mark.parametrize("batch_size", [(), (5,), (400, 7), (0,)], ids=str)
def test_draws_lie_on_the_simplex(sampler, batch_size):
    preferences = sampler(*batch_size)
    assert preferences.shape == (*batch_size, sampler.num_objectives)
    assert preferences.dtype == torch.float32
    assert (preferences >= 0).all()
    torch.testing.assert_close(preferences.sum(-1), torch.ones(batch_size))


@pytest.mark.parametrize("sampler", SAMPLERS, ids=lambda sampler: f"{type(sampler).__name__}{sampler.num_objectives}")
def test_a_generator_alone_decides_the_draw(sampler):
    def draw():
        return sampler(6, generator=torch.Generator().manual_seed(3))

    before = torch.get_rng_state()
    assert torch.equal(draw(), draw())
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_uniform_draws_have_beta_marginals(n):
    for entry in UniformPreferences(n)(4000).unbind(-1):
        assert kstest(entry, "beta", (1, n - 1)).pvalue > 1e-3


def test_dirichlet_draws_have_the_named_mean():
    concentration = torch.tensor([0.5, 1.0, 2.5])
    mean = DirichletPreferences(3, concentration.tolist())(20000).mean(0)
    torch.testing.assert_close(mean, concentration / concentration.sum(), atol=0.01, rtol=0)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_segments_do_not_overlap_and_together_are_the_uniform_simplex(n):
    preferences = SegmentedPreferences(n, 3)(4000, 3)
    first = preferences[..., 0]
    assert first[:, 0].max() <= first[:, 1].min() + 1e-6
    assert first[:, 1].max() <= first[:, 2].min() + 1e-6
    for entry in preferences.flatten(0, 1).unbind(-1):
        assert kstest(entry, "beta", (1, n - 1)).pvalue > 1e-3


def test_environments_take_segments_in_turn():
    first = SegmentedPreferences(2, 3, offset=1)(1000, 4)[..., 0]
    segment = (first.mean(0) * 3).floor()
    assert segment.tolist() == [1, 2, 0, 1]
    assert 2 / 3 <= SegmentedPreferences(2, 3, offset=5)()[0] <= 1


def test_corner_weighted_draws_keep_their_shares():
    positive = (CornerWeightedPreferences(3, corner=0.2, edge=0.3)(20000) > 0).sum(-1)
    shares = torch.stack([(positive == count).float().mean() for count in (1, 2, 3)])
    torch.testing.assert_close(shares, torch.tensor([0.2, 0.3, 0.5]), atol=0.02, rtol=0)


def test_corners_and_edges_are_visited_evenly():
    preferences = CornerWeightedPreferences(4, corner=0.5, edge=0.5)(20000)
    torch.testing.assert_close(preferences.mean(0), torch.full((4,), 0.25), atol=0.02, rtol=0)


def test_grid_draws_are_rows_of_the_grid():
    drawn = GridPreferences(3, 4)(2000).unique(dim=0)
    assert torch.equal(drawn, simplex_grid(3, 4))


def test_noisy_grid_draws_are_near_rows_of_the_grid_on_all_sides():
    drawn = GridPreferences(2, 2, noise=0.1)(4000)[:, 0]
    middle = drawn[(drawn > 0.25) & (drawn < 0.75)]
    low, high = 0.4 / (0.4 + 0.6), 0.6 / (0.6 + 0.4)  # both weights are off by 0.1, in opposite directions
    assert low <= middle.min() < low + 0.01
    assert high - 0.01 < middle.max() <= high
    assert drawn.min() == 0
    assert drawn.max() == 1
    assert (middle - 0.5).mean().abs() < 0.01


def test_a_fixed_draw_can_be_written_to_without_changing_the_next():
    sampler = FixedPreferences([0.25, 0.75])
    sampler(3).zero_()
    assert sampler(1).tolist() == [[0.25, 0.75]]


@pytest.mark.parametrize(
    "build",
    [
        lambda: simplex_grid(0, 10),
        lambda: simplex_grid(3, 0),
        lambda: preference_edges(0, 10),
        lambda: UniformPreferences(0),
        lambda: DirichletPreferences(3, 0.0),
        lambda: DirichletPreferences(3, [1.0, 1.0]),
        lambda: SegmentedPreferences(3, 0),
        lambda: SegmentedPreferences(3, 3, offset=-1),
        lambda: CornerWeightedPreferences(3, 0.8, 0.3),
        lambda: FixedPreferences([0.5, 0.6]),
        lambda: FixedPreferences([-0.5, 1.5]),
    ],
)
def test_a_wrong_argument_is_named_in_one_sentence(build):
    with pytest.raises(ValueError, match=r"must (not )?be .*\.$"):
        build()
