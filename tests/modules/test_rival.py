import pytest
import torch

from morlnav.modules import Rival


class Backward(Rival):
    def __call__(self, policy, observation, preference):
        return -policy(observation, preference)


def forward(observation, preference):
    return observation + preference


@pytest.mark.parametrize(("share", "driven"), [(0.0, []), (0.25, [3, 7]), (0.5, [1, 3, 5, 7]), (1.0, list(range(8)))])
def test_a_rival_drives_its_share_of_the_environments(share, driven):
    observation, preference = torch.rand(3, 8, 2), torch.rand(3, 8, 2)
    action = Backward(share).beside(forward)(observation, preference)
    sign = torch.ones(8, 1)
    sign[driven] = -1
    assert torch.equal(action, sign * forward(observation, preference))


def test_a_single_environment_is_the_policy_own():
    assert Backward(1.0).beside(forward)(torch.ones(2), torch.ones(2)).tolist() == [2, 2]


def test_a_share_above_one_is_refused():
    with pytest.raises(ValueError, match=r"share must be between 0 and 1, got 1\.5"):
        Backward(1.5)
