"""Relabelling at sampling equals PD-MORL's relabelling at insertion, with one stored copy instead of four."""

import pytest
import torch
from scipy.stats import ks_2samp
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import (
    LazyMemmapStorage,
    LazyTensorStorage,
    ListStorage,
    RandomSampler,
    ReplayBuffer,
    TensorDictPrioritizedReplayBuffer,
    TensorDictReplayBuffer,
)
from torchrl.data.replay_buffers.samplers.prioritized import SumSegmentTreeFp32
from torchrl.envs import PendulumEnv, TransformedEnv

from morlnav.data.preferences import FixedPreferences, UniformPreferences
from morlnav.transforms.preference import DrawPreference
from morlnav.transforms.relabel import HindsightPreferenceRelabel

OWN = torch.tensor([0.5, 0.25, 0.25])


class WeightedSampler(RandomSampler):
    """Gives each transition its own number as weight."""

    def sample(self, storage, batch_size):
        index, info = super().sample(storage, batch_size)
        return index, {**info, "priority_weight": index.float()}


def transitions(count: int, preference: Tensor = OWN) -> TensorDict:
    preference = preference.expand(count, 3).clone()
    number = torch.arange(count)
    return TensorDict(
        {"number": number, "preference": preference, "next": {"number": number + 1, "preference": preference.clone()}},
        [count],
    )


def filled(transform=None, buffer=TensorDictReplayBuffer, storage=LazyTensorStorage, **kwargs):
    buffer = buffer(storage=storage(1000), transform=transform, **{"batch_size": 256, **kwargs})
    buffer.extend(transitions(1000))
    return buffer


def is_own(batch: TensorDict) -> Tensor:
    return (batch["preference"] == OWN).all(-1)


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.mark.parametrize("storage", [LazyTensorStorage, LazyMemmapStorage, ListStorage])
@pytest.mark.parametrize("buffer", [ReplayBuffer, TensorDictReplayBuffer])
def test_sampling_relabels_and_leaves_the_stored_transitions_alone(buffer, storage):
    buffer = filled(HindsightPreferenceRelabel(UniformPreferences(3)), buffer, storage)
    batch = buffer.sample()
    assert batch.shape == (256,)
    assert not is_own(batch).any()
    assert torch.equal(batch["preference"], batch["next", "preference"])
    assert torch.equal(batch["next", "number"], batch["number"] + 1)
    stored = buffer.storage.get(torch.arange(1000))
    stored = torch.stack(stored) if isinstance(stored, list) else stored
    assert is_own(stored).all()
    assert is_own(stored["next"]).all()


def test_a_share_of_zero_changes_nothing_and_of_one_everything():
    assert is_own(filled(HindsightPreferenceRelabel(UniformPreferences(3), share=0.0)).sample()).all()
    assert not is_own(filled(HindsightPreferenceRelabel(UniformPreferences(3), share=1.0)).sample()).any()


def test_the_distribution_is_that_of_four_copies_relabelled_at_insertion():
    sampler = UniformPreferences(3)
    expected = torch.cat([transitions(1000), *(transitions(1000, sampler(1000)) for _ in range(3))])
    sampled = filled(HindsightPreferenceRelabel(sampler, share=0.75), batch_size=4000).sample()

    own, sampled_own = is_own(expected), is_own(sampled)
    torch.testing.assert_close(sampled_own.float().mean(), own.float().mean(), atol=0.03, rtol=0)
    torch.testing.assert_close(sampled_own.float().mean(), torch.tensor(0.25), atol=0.02, rtol=0)
    fresh, sampled_fresh = expected["preference"][~own], sampled["preference"][~sampled_own]
    torch.testing.assert_close(sampled_fresh.mean(0), fresh.mean(0), atol=0.02, rtol=0)
    torch.testing.assert_close(sampled_fresh.T.cov(), fresh.T.cov(), atol=0.01, rtol=0)
    for entry in range(3):
        assert ks_2samp(sampled_fresh[:, entry], fresh[:, entry]).pvalue > 1e-3


def test_relabelling_does_not_favour_any_transition():
    batch = filled(HindsightPreferenceRelabel(UniformPreferences(3), share=0.5), batch_size=8000).sample()
    numbers = batch["number"].float()
    assert ks_2samp(numbers[is_own(batch)], numbers[~is_own(batch)]).pvalue > 1e-3


def test_several_relabels_return_each_transition_as_often_with_preferences_of_their_own():
    batch = filled(HindsightPreferenceRelabel(UniformPreferences(3), share=0.75, num_relabels=4)).sample()
    assert batch.shape == (256, 4)
    assert (batch["number"] == batch["number"][:, :1]).all()
    assert (batch["index"] == batch["number"]).all()
    assert torch.equal(batch["preference"], batch["next", "preference"])
    fresh = batch["preference"][~is_own(batch)]
    assert len(fresh.unique(dim=0)) == len(fresh)
    torch.testing.assert_close(is_own(batch).float().mean(), torch.tensor(0.25), atol=0.05, rtol=0)


@pytest.mark.parametrize("num_relabels", [1, 3])
def test_index_and_priority_weight_follow_their_transition(num_relabels):
    relabel = HindsightPreferenceRelabel(UniformPreferences(3), num_relabels=num_relabels)
    batch = filled(relabel, sampler=WeightedSampler()).sample()
    assert torch.equal(batch["index"], batch["number"])
    assert torch.equal(batch["priority_weight"], batch["number"].float())


@pytest.mark.skipif(SumSegmentTreeFp32 is None, reason="TorchRL's compiled extension does not fit this torch")
@pytest.mark.parametrize("num_relabels", [1, 3])
def test_a_prioritized_buffer_prefers_transitions_of_high_priority(num_relabels):
    relabel = HindsightPreferenceRelabel(UniformPreferences(3), num_relabels=num_relabels)
    buffer = filled(relabel, TensorDictPrioritizedReplayBuffer, alpha=1.0, beta=1.0, batch_size=1000)
    for _ in range(10):
        batch = buffer.sample()
        buffer.update_tensordict_priority(batch.set("td_error", (batch["number"] < 10).float()))
    batch = buffer.sample()
    assert torch.equal(batch["index"], batch["number"])
    assert batch["priority_weight"].shape == batch.shape
    assert (batch["number"] < 10).float().mean() > 0.9


def test_sequences_are_relabelled_step_by_step():
    batch = transitions(12).reshape(3, 4)
    assert HindsightPreferenceRelabel(UniformPreferences(3))(batch)["preference"].shape == (3, 4, 3)
    assert not is_own(batch).any()


def test_other_keys_can_be_named():
    batch = TensorDict({"user": {"weights": OWN.expand(5, 3)}, "next": {"user": {"weights": OWN.expand(5, 3)}}}, [5])
    relabel = HindsightPreferenceRelabel(
        FixedPreferences([0, 0, 1]), preference_key=("user", "weights"), next_key=("next", "user", "weights")
    )
    relabel(batch)
    assert (batch["user", "weights"] == torch.tensor([0.0, 0.0, 1.0])).all()
    assert (batch["next", "user", "weights"] == torch.tensor([0.0, 0.0, 1.0])).all()


def test_an_environment_is_stepped_as_if_the_transform_were_not_there():
    env = TransformedEnv(PendulumEnv(), DrawPreference(FixedPreferences(OWN)))
    env.append_transform(HindsightPreferenceRelabel(UniformPreferences(3)))
    rollout = env.rollout(5)
    assert is_own(rollout).all()
    assert is_own(rollout["next"]).all()


@pytest.mark.parametrize("wrong", [{"share": -0.1}, {"share": 1.1}, {"num_relabels": 0}])
def test_a_wrong_argument_is_named_in_one_sentence(wrong):
    with pytest.raises(ValueError, match=r"must be .*\.$"):
        HindsightPreferenceRelabel(UniformPreferences(3), **wrong)
