import pytest
import torch

from morlnav.objectives import LinearScalarisation


def test_a_preference_longer_than_the_rewards_is_refused():
    with pytest.raises(ValueError, match="preference of 3 entries cannot weigh 2 objectives"):
        LinearScalarisation()(torch.rand(4, 3), 2)


def test_ties_are_broken_by_a_small_weight_on_every_tuneable_objective():
    weights = LinearScalarisation(tie_break=0.1)(torch.tensor([1.0, 0.0]), 3)
    torch.testing.assert_close(weights, torch.tensor([1.0, 1.1, 0.1]))


def test_ties_may_be_broken_by_some_objectives_alone():
    weights = LinearScalarisation(tie_break=[0.0, 0.3])(torch.tensor([[1.0, 0.0], [0.0, 1.0]]), 3)
    torch.testing.assert_close(weights, torch.tensor([[1.0, 1.0, 0.3], [1.0, 0.0, 1.3]]))


def test_styles_may_weigh_less_than_static_objectives():
    weights = LinearScalarisation(scale=[0.5, 1.0], tie_break=[0.0, 0.3])(torch.tensor([[1.0, 0.0], [0.0, 1.0]]), 4)
    torch.testing.assert_close(weights, torch.tensor([[1.0, 1.0, 0.5, 0.3], [1.0, 1.0, 0.0, 1.3]]))


def test_a_style_may_weigh_nothing():
    weights = LinearScalarisation(scale=0.0)(torch.ones(1, 1), 2)
    assert weights.tolist() == [[1.0, 0.0]]


def test_wrong_scales_and_tie_breaks_are_named():
    with pytest.raises(ValueError, match="scale must not be negative"):
        LinearScalarisation(scale=-0.1)
    with pytest.raises(ValueError, match="tie_break must not be negative"):
        LinearScalarisation(tie_break=[0.1, -0.1])
    with pytest.raises(ValueError, match="tie_break has 2 entries, the preference 3"):
        LinearScalarisation(tie_break=[0.1, 0.1])(torch.rand(4, 3), 4)
