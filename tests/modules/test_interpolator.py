"""The interpolator is scipy's linear RBF on value directions, and its keys follow the evaluations."""

import pytest
import torch
from scipy.interpolate import RBFInterpolator
from torch.nn.functional import normalize

from morlnav.data import UniformPreferences, preference_edges, simplex_grid
from morlnav.modules.interpolator import PreferenceInterpolator
from morlnav.objectives import LinearScalarisation

CORNERS = torch.eye(2)
VALUES = torch.tensor([[5.0, -2.0, -9.0], [5.0, -9.0, -2.0]])


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.fixture
def interpolator():
    return PreferenceInterpolator(2, preferences=CORNERS, values=VALUES, decay=1.0)


def test_keys_may_be_whole_numbers():
    whole = PreferenceInterpolator(2, preferences=[[1, 0], [0, 1]], values=[[5, -2, -9], [5, -9, -2]])
    torch.testing.assert_close(whole(CORNERS), normalize(VALUES, dim=-1))


def best_value(preference):
    """A concave front: the value that is best at a preference, with a baseline and two costs."""
    return torch.cat([torch.full_like(preference[..., :1], 10.0), 4 * normalize(preference, dim=-1) - 8], -1)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-4), (torch.float64, 1e-8)])
@pytest.mark.parametrize(("n", "num_static", "steps"), [(2, 0, 10), (2, 1, 5), (3, 1, 10), (4, 2, 4), (5, 1, 3)])
def test_it_agrees_with_scipy(n, num_static, steps, dtype, tolerance):
    keys = simplex_grid(n, steps).to(dtype)
    values = torch.randn(len(keys), num_static + n, dtype=dtype) * 100 + 50
    queries = UniformPreferences(n)(200).to(dtype)
    interpolator = PreferenceInterpolator(n, num_static, preferences=keys, values=values)
    scipy = RBFInterpolator(keys.double(), normalize(values.double(), dim=-1), kernel="linear")
    expected = normalize(torch.from_numpy(scipy(queries.double())), dim=-1)
    torch.testing.assert_close(interpolator(queries), expected.to(dtype), atol=tolerance, rtol=0)


def test_at_a_key_it_returns_the_direction_of_the_keys_value():
    keys = simplex_grid(3, 10)
    interpolator = PreferenceInterpolator(3, steps=10, values=best_value(keys))
    torch.testing.assert_close(interpolator(keys), normalize(best_value(keys), dim=-1), atol=1e-4, rtol=0)


def test_directions_keep_the_sign_of_costs(interpolator):
    between = interpolator(torch.tensor([0.5, 0.5]))
    assert (between.sign() == torch.tensor([1.0, -1.0, -1.0])).all()
    torch.testing.assert_close(between[1], between[2])


def test_keys_may_be_ranked_by_the_weights_of_the_learner():
    learners = LinearScalarisation(scale=[1.0, 4.0])
    slow, fast = torch.tensor([9.0, -1.0, -4.0]), torch.tensor([7.0, -4.0, -2.0])
    for weights, kept in ((None, slow), (learners, fast)):  # 6.5 against 4, and 0.5 against 1
        key = PreferenceInterpolator(2, preferences=[[0.5, 0.5]], weights=weights)
        expected = torch.tensor([1.0, 0.5, 0.5 if weights is None else 2.0])
        torch.testing.assert_close(key.values[0], expected)
        torch.testing.assert_close(key(key.preferences)[0], normalize(expected, dim=-1))
        key.update(torch.tensor([[0.4, 0.6], [0.6, 0.4]]), torch.stack([slow, fast]))
        torch.testing.assert_close(key.values[0], kept)


@pytest.mark.parametrize("shape", [(3,), (7, 3), (2, 5, 3), (0, 3)], ids=str)
def test_directions_are_unit_vectors_for_any_batch(shape):
    preference = torch.rand(shape)
    preference = preference / preference.sum(-1, keepdim=True)
    for interpolator in (
        PreferenceInterpolator(3, steps=10),
        PreferenceInterpolator(3, steps=10, values=torch.randn(66, 4)),
    ):
        direction = interpolator(preference)
        assert direction.shape == (*shape[:-1], 4)
        torch.testing.assert_close(direction.norm(dim=-1), torch.ones(shape[:-1]))


def test_before_the_first_update_the_direction_is_that_of_the_weights():
    interpolator = PreferenceInterpolator(3, steps=10)
    preference = UniformPreferences(3)(5)
    assert not interpolator.ready
    weights = torch.cat([torch.ones(5, 1), preference], -1)
    torch.testing.assert_close(interpolator(preference), normalize(weights, dim=-1))


def test_the_first_update_makes_it_ready_even_with_returns_below_the_start():
    interpolator = PreferenceInterpolator(2, preferences=CORNERS)
    assert interpolator.update(CORNERS, -100 * VALUES.abs()).all()
    assert interpolator.ready
    torch.testing.assert_close(interpolator(CORNERS), normalize(-VALUES.abs(), dim=-1))


def test_a_few_evaluations_give_every_key_the_one_that_is_best_for_it():
    interpolator = PreferenceInterpolator(3, steps=10)
    edges = preference_edges(3, 1)
    interpolator.update(edges, best_value(edges))
    weights = torch.cat([torch.ones(66, 1), interpolator.preferences], -1)
    best = (weights @ best_value(edges).T).amax(-1)
    torch.testing.assert_close((weights * interpolator.values).sum(-1), best)


def test_evaluating_every_key_recovers_the_front():
    interpolator = PreferenceInterpolator(3, steps=10)
    keys = interpolator.preferences
    interpolator.update(keys, best_value(keys))
    torch.testing.assert_close(interpolator.values, best_value(keys))
    queries = UniformPreferences(3)(100)
    cosine = (interpolator(queries) * normalize(best_value(queries), dim=-1)).sum(-1)
    assert cosine.min() > 0.999


def test_a_better_result_replaces_a_key_and_a_worse_one_does_not(interpolator):
    better, worse = torch.tensor([5.0, -1.0, -12.0]), torch.tensor([5.0, -9.0, -4.0])
    raised = interpolator.update(CORNERS, torch.stack([better, worse]))
    assert raised.tolist() == [True, False]
    torch.testing.assert_close(interpolator.values, torch.stack([better, VALUES[1]]))
    torch.testing.assert_close(interpolator(CORNERS[0]), normalize(better, dim=-1))


def test_a_result_from_another_preference_may_raise_a_key(interpolator):
    found = torch.tensor([5.0, -1.0, -8.0])
    assert interpolator.update(torch.tensor([[0.7, 0.3]]), found[None]).tolist() == [True, False]


def test_without_decay_a_lucky_evaluation_stays_for_ever(interpolator):
    for _ in range(50):
        interpolator.update(CORNERS, VALUES - 3)
    torch.testing.assert_close(interpolator.values, VALUES)


def test_with_decay_a_lucky_evaluation_is_forgotten():
    interpolator = PreferenceInterpolator(2, preferences=CORNERS, values=VALUES, decay=0.5)
    interpolator.update(CORNERS, VALUES - 4)
    torch.testing.assert_close(interpolator.values, VALUES - 2)
    for _ in range(50):
        interpolator.update(CORNERS, VALUES - 4)
    torch.testing.assert_close(interpolator.values, VALUES - 4)


def test_every_key_of_the_grid_decays_when_it_is_measured_again():
    keys = simplex_grid(3, 10)
    interpolator = PreferenceInterpolator(3, steps=10, values=best_value(keys), decay=0.5)
    interpolator.update(keys, best_value(keys) - 4)
    torch.testing.assert_close(interpolator.values, best_value(keys) - 2)


def test_only_keys_that_were_measured_again_decay():
    interpolator = PreferenceInterpolator(2, preferences=CORNERS, values=VALUES, decay=0.5)
    interpolator.update(CORNERS[:1], VALUES[:1] - 4)
    torch.testing.assert_close(interpolator.values, torch.stack([VALUES[0] - 2, VALUES[1]]))


def test_results_that_are_not_finite_are_left_out(interpolator):
    better = VALUES + 1
    assert interpolator.update(CORNERS, better + torch.tensor([[torch.nan], [0.0]])).tolist() == [False, True]
    broken = better + torch.tensor([[torch.nan], [torch.inf]])
    assert not interpolator.update(CORNERS, broken).any()
    assert interpolator.coefficients.isfinite().all()


def test_an_update_without_any_result_changes_nothing():
    interpolator = PreferenceInterpolator(2, preferences=CORNERS)
    before = interpolator.values.clone()
    assert not interpolator.update(CORNERS, VALUES * torch.nan).any()
    assert not interpolator.ready
    assert torch.equal(interpolator.values, before)


def test_a_value_of_length_zero_stays_finite():
    interpolator = PreferenceInterpolator(2, preferences=CORNERS, values=torch.zeros(2, 3))
    assert interpolator(UniformPreferences(2)(10)).isfinite().all()


def test_the_state_dict_restores_keys_values_and_readiness(interpolator):
    interpolator.update(CORNERS, VALUES + 1)
    restored = PreferenceInterpolator(2, preferences=CORNERS.flip(0))
    restored.load_state_dict(interpolator.state_dict())
    preference = UniformPreferences(2)(10)
    assert restored.ready
    assert torch.equal(restored(preference), interpolator(preference))


def test_gradients_reach_the_preference_and_no_buffer(interpolator):
    preference = torch.tensor([[1.0, 0.0], [0.3, 0.7]], requires_grad=True)  # the first one is a key
    interpolator(preference)[:, 1].sum().backward()
    assert preference.grad.isfinite().all()
    assert not list(interpolator.parameters())


@pytest.mark.parametrize(
    "wrong",
    [
        {"preferences": torch.tensor([[0.5, 0.5], [0.5, 0.5]])},
        {"preferences": torch.eye(3)},
        {"preferences": CORNERS, "values": torch.zeros(2, 2)},
        {"num_static": -1},
        {"decay": 0.0},
        {"decay": 1.5},
    ],
    ids=str,
)
def test_a_wrong_argument_is_named_in_one_sentence(wrong):
    with pytest.raises(ValueError, match=r"must .*\.$"):
        PreferenceInterpolator(2, **wrong)


def test_results_of_the_wrong_shape_are_refused(interpolator):
    with pytest.raises(ValueError, match=r"must have the shapes \[E, 2\] and \[E, 3\]"):
        interpolator.update(CORNERS, VALUES[:1])
    with pytest.raises(ValueError, match="must have the shapes"):
        interpolator.update(CORNERS[:0], VALUES[:0])
