"""The examples do what they promise."""

import runpy
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_a_policy_trained_on_the_learned_reward_beats_the_clone():
    _, clone, policy = runpy.run_path(str(EXAMPLES / "pendulum_drex.py"))["main"](seed=0)
    assert policy > clone
