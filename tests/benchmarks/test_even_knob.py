import pytest

import morlnav
from benchmarks.even_knob import measure
from morlnav.navigation.evaluation import evaluation_scenes, reference_paths
from morlnav.navigation.modules import CircumnavigationOracle


def test_a_balanced_knob_moves_sooner_between_the_same_ends():
    scenes = evaluation_scenes(6, seed=3)
    paths = reference_paths(scenes, CircumnavigationOracle())
    policies = (morlnav.load("results/default", balance=balance) for balance in (None, {"demo": 0.3}))
    plain, even = (list(map(float, measure(policy, scenes, paths, steps=4)[-1].split(", "))) for policy in policies)
    assert (plain[0], plain[-1]) == (even[0], even[-1])
    assert all(there > here for here, there in zip(plain[1:-1], even[1:-1], strict=True))


def test_a_policy_of_other_styles_is_refused():
    with pytest.raises(ValueError, match="the policy weighs distance, efficiency"):
        measure(morlnav.load("results/two_styles/seed_0"), evaluation_scenes(1), [])
