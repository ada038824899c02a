import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_a_policy_trained_on_the_learned_reward_beats_the_clone():
    _, clone, policy = runpy.run_path(str(EXAMPLES / "pendulum_drex.py"))["main"](seed=0)
    assert policy > clone


@pytest.mark.parametrize(("task", "objectives"), [("mo-mountaincarcontinuous-v0", 2), ("mo-hopper-v5", 3)])
def test_a_policy_for_all_preferences_trains_on_a_task_of_mo_gymnasium(task, objectives):
    if "hopper" in task:
        pytest.importorskip("mujoco")
    returns = runpy.run_path(str(EXAMPLES / "mo_gymnasium_td3.py"))["main"](task, frames=128, max_steps=100)
    assert len(returns) == objectives * (objectives + 1) // 2
    assert all(len(row) == objectives for row in returns.values())
    assert len({tuple(row) for row in returns.values()}) == len(returns)  # the preference makes a difference
