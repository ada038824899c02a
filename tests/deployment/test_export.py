"""Exported policies act as the original does, wherever they run."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

import morlnav
from morlnav.deployment.export import export_policy

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

RESULTS = Path(__file__).parents[2] / "results"


@pytest.fixture(scope="module", params=["smoke", "trained"])
def policy(request, smoke_run):
    return morlnav.load(smoke_run if request.param == "smoke" else RESULTS / "default")


@pytest.fixture(scope="module")
def exported(policy, tmp_path_factory):
    return export_policy(policy, tmp_path_factory.mktemp("export"))


def inputs(policy, count):
    generator = torch.Generator().manual_seed(0)
    observation = torch.rand(count, 34, generator=generator) * 4
    observation[:, [1, 3]] = (2 * torch.rand(count, 2, generator=generator) - 1) * torch.pi
    preference = torch.rand(count, len(policy.objectives), generator=generator)
    return observation, preference / preference.sum(-1, keepdim=True)


def assert_alike(policy, action, expected):
    """To 1e-5 in SI units; of a trained policy in half ranges, for its ω is not exact to 1e-5 rad/s in float32."""
    if policy.objectives == ("demo", "distance", "efficiency"):
        action, expected = policy.actor.to_unit(action), policy.actor.to_unit(expected)
    torch.testing.assert_close(action, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("count", [1, 10_000])
def test_onnx_gives_the_same_actions(policy, exported, count):
    observation, preference = inputs(policy, count)
    session = onnxruntime.InferenceSession(exported["onnx"], providers=["CPUExecutionProvider"])
    (action,) = session.run(["action"], {"observation": observation.numpy(), "preference": preference.numpy()})
    assert_alike(policy, torch.from_numpy(action), policy(observation, preference))


@pytest.mark.parametrize("count", [1, 10_000])
def test_the_exported_program_gives_the_same_actions(policy, exported, count):
    observation, preference = inputs(policy, count)
    action = torch.export.load(exported["pt2"]).module()(observation, preference)
    assert_alike(policy, action, policy(observation, preference))


def test_the_preference_stays_an_input(policy, exported):
    observation, _ = inputs(policy, 5)
    session = onnxruntime.InferenceSession(exported["onnx"], providers=["CPUExecutionProvider"])
    corners = np.eye(len(policy.objectives), dtype=np.float32)
    one, other = (
        session.run(None, {"observation": observation.numpy(), "preference": corners[[i] * 5]})[0] for i in (0, 1)
    )
    assert (one != other).any()


def test_the_files_name_the_objectives(policy, exported):
    metadata = {entry.key: entry.value for entry in onnx.load(exported["onnx"]).metadata_props}
    assert tuple(json.loads(metadata["objectives"])) == policy.objectives
    extra = {"objectives": ""}
    torch.export.load(exported["pt2"], extra_files=extra)
    assert tuple(json.loads(extra["objectives"])) == policy.objectives


def test_unknown_formats_are_refused(policy, tmp_path):
    with pytest.raises(ValueError, match="no format tflite; choose from: onnx, pt2"):
        export_policy(policy, tmp_path, ("tflite",))
