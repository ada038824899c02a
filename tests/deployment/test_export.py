"""Exported policies act as the original does, wherever they run."""

import json
from pathlib import Path

import pytest
import torch

import morlnav
from morlnav.deployment.export import export_policy

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

RESULTS = Path(__file__).parents[2] / "results"


@pytest.fixture(scope="module", params=["smoke", "trained", "balanced"])
def policy(request, smoke_run):
    balance = {"demo": 0.3} if request.param == "balanced" else None
    return morlnav.load(smoke_run if request.param == "smoke" else RESULTS / "default", balance=balance)


@pytest.fixture(scope="module")
def exported(policy, tmp_path_factory):
    return export_policy(policy, tmp_path_factory.mktemp("export"))


def inputs(policy, count):
    generator = torch.Generator().manual_seed(0)
    observation = torch.rand(count, 34, generator=generator) * 4
    observation[:, [1, 3]] = (2 * torch.rand(count, 2, generator=generator) - 1) * torch.pi
    preference = torch.rand(count, len(policy.objectives), generator=generator)
    return observation, preference / preference.sum(-1, keepdim=True)


def run(exported, form, observation, preference):
    """What an exported file answers, wherever it runs."""
    if form == "pt2":
        return torch.export.load(exported["pt2"]).module()(observation, preference)
    session = onnxruntime.InferenceSession(exported["onnx"], providers=["CPUExecutionProvider"])
    feed = {"observation": observation.numpy(), "preference": preference.numpy()}
    return torch.from_numpy(session.run(["action"], feed)[0])


def assert_alike(policy, action, expected):
    """To 1e-5 in SI units; of a trained policy in half ranges, for its ω is not exact to 1e-5 rad/s in float32."""
    if policy.objectives == ("demo", "distance", "efficiency"):
        action, expected = policy.actor.to_unit(action), policy.actor.to_unit(expected)
    torch.testing.assert_close(action, expected, rtol=0, atol=1e-5)


BOTH = pytest.mark.parametrize("form", ["onnx", "pt2"])


@BOTH
@pytest.mark.parametrize("count", [1, 10_000])
def test_the_file_gives_the_same_actions(policy, exported, form, count):
    observation, preference = inputs(policy, count)
    assert_alike(policy, run(exported, form, observation, preference), policy(observation, preference))


@BOTH
def test_the_preference_stays_an_input(policy, exported, form):
    observation, _ = inputs(policy, 5)
    corners = torch.eye(len(policy.objectives))
    one, other = (run(exported, form, observation, corners[[i] * 5]) for i in (0, 1))
    assert (one != other).any()


@BOTH
@pytest.mark.parametrize("entry", [0, 3, 33])
@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf, 3e38])
def test_an_observation_that_makes_no_sense_is_answered_by_a_stop(policy, exported, form, entry, value):
    observation, preference = inputs(policy, 3)
    expected = policy(observation, preference)
    observation[1, entry] = value
    action = run(exported, form, observation, preference)
    assert action.isfinite().all()
    assert action[1].tolist() == [0, 0]
    assert_alike(policy, action[[0, 2]], expected[[0, 2]])


@BOTH
@pytest.mark.parametrize(
    ("entry", "value"), [(0, -1.0), (0, 1e4), (1, 100.0), (2, -5.0), (3, -3.2), (4, -0.1), (33, 4.1), (20, 1e4)]
)
def test_an_observation_that_nothing_can_measure_is_answered_by_a_stop(policy, exported, form, entry, value):
    observation, preference = inputs(policy, 3)
    observation[1, entry] = value
    action = run(exported, form, observation, preference)
    assert action[1].tolist() == [0, 0]
    assert_alike(policy, action[[0, 2]], policy(observation[[0, 2]], preference[[0, 2]]))
    with pytest.raises(ValueError, match=f"keep to what can be measured, got {value:g} in entry {entry}, which goes"):
        policy(observation, preference)


@BOTH
@pytest.mark.parametrize(
    "start", [[5.0, -3.0], [-0.1, 1.1], [0.5, 0.6], [0.0, 0.0], [torch.nan, 1.0], [torch.inf, 0.0]]
)
def test_a_preference_off_the_simplex_is_answered_by_a_stop(policy, exported, form, start):
    observation, preference = inputs(policy, 2)
    preference[1] = torch.tensor([*start, *[0.0] * len(policy.objectives)])[: len(policy.objectives)]
    action = run(exported, form, observation, preference)
    assert action[1].tolist() == [0, 0]
    assert_alike(policy, action[0], policy(observation[0], preference[0]))


@BOTH
def test_a_preference_may_be_rounded(policy, exported, form):
    observation, _ = inputs(policy, 1)
    preference = torch.tensor([[0.333, 0.333, 0.333]])[:, : len(policy.objectives)]
    preference[0, -1] = 1 - preference[0, :-1].sum() - 0.0009
    assert run(exported, form, observation, preference).any()


def test_the_files_name_the_objectives(policy, exported):
    metadata = {entry.key: entry.value for entry in onnx.load(exported["onnx"]).metadata_props}
    assert tuple(json.loads(metadata["objectives"])) == policy.objectives
    extra = {"objectives": ""}
    torch.export.load(exported["pt2"], extra_files=extra)
    assert tuple(json.loads(extra["objectives"])) == policy.objectives


def test_unknown_formats_are_refused(policy, tmp_path):
    with pytest.raises(ValueError, match="no format tflite; choose from: onnx, pt2"):
        export_policy(policy, tmp_path, ("tflite",))
