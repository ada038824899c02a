import pytest

import morlnav
from benchmarks.even_knob import measure
from morlnav.navigation.evaluation import evaluation_scenes


def test_a_balanced_knob_moves_sooner_between_the_same_ends():
    scenes = evaluation_scenes(6, seed=3)
    plain, even = (
        [
            float(metres)
            for metres in measure(morlnav.load("results/default", balance=balance), scenes, 4)[-1].split(", ")
        ]
        for balance in (None, {"demo": 0.3})
    )
    assert (plain[0], plain[-1]) == (even[0], even[-1])
    assert all(there > here for here, there in zip(plain[1:-1], even[1:-1], strict=True))


def test_a_policy_of_other_styles_is_refused():
    with pytest.raises(ValueError, match="the policy weighs distance, efficiency"):
        measure(morlnav.load("results/two_styles/seed_0"), evaluation_scenes(1))
