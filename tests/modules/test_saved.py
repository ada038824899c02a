"""Modules on disk: exactly what was saved, without pickled code, and of our own classes alone."""

import hashlib
import json
import re

import pytest
import torch
from torch import nn

from morlnav.modules import (
    Actor,
    NormalisedReward,
    RewardEnsemble,
    RewardModel,
    load_module,
    read_facts,
    save_module,
    write_facts,
)
from morlnav.navigation.modules import NavigationFeatures

SMALL = {"action_low": [0.0, -3.14], "action_high": [0.5, 3.14], "features": 34, "depth": 1, "num_cells": 8}


@pytest.fixture
def model():
    torch.manual_seed(0)
    members = [RewardModel(("observation",), **SMALL), RewardModel(("observation", "action"), **SMALL)]
    return NormalisedReward(RewardEnsemble(members, "pessimistic"), low=0.1, high=0.6)


def test_a_saved_model_comes_back_frozen_and_exactly_the_same(model, tmp_path):
    path = tmp_path / "new" / "reward.pt"
    save_module(model, path, {"audit": {"rank": 1, "margin": 24.0}})
    loaded = load_module(path)
    observation, action = torch.rand(50, 34), torch.rand(50, 2)
    assert torch.equal(loaded(observation, action), model(observation, action))
    assert not loaded.training
    assert not any(parameter.requires_grad for parameter in loaded.parameters())
    assert read_facts(path) == {"audit": {"rank": 1, "margin": 24.0}}
    assert loaded.low == pytest.approx(0.1)
    assert [member.inputs for member in loaded.model.models] == [member.inputs for member in model.model.models]


def test_nothing_that_is_drawn_depends_on_what_was_loaded(model, tmp_path):
    save_module(model, tmp_path / "reward.pt")
    torch.manual_seed(1)
    drawn = torch.rand(3)
    torch.manual_seed(1)
    load_module(tmp_path / "reward.pt")
    assert torch.equal(torch.rand(3), drawn)


def test_facts_may_be_replaced_and_the_weights_stay(model, tmp_path):
    path = tmp_path / "reward.pt"
    save_module(model, path, {"held_out": 0.5})
    before = path.read_bytes()
    write_facts(path, {"held_out": 0.5, "audit": "passed"})
    assert read_facts(path) == {"held_out": 0.5, "audit": "passed"}
    assert path.read_bytes() == before
    assert torch.equal(load_module(path).high, model.high)


def test_the_shape_of_observation_and_action_is_kept(tmp_path):
    features = NavigationFeatures(observe_human=False, lidar_range=6.0, sectors=12, octaves=2)
    reward = RewardModel(("observation", "action"), [0.0, -1.0], [1.0, 2.0], features, depth=1, num_cells=8)
    save_module(reward, tmp_path / "reward.pt")
    loaded = load_module(tmp_path / "reward.pt")
    assert loaded.features.config() == features.config()
    assert loaded(torch.rand(3, 14), torch.rand(3, 2)).shape == (3,)


def test_an_actor_on_bare_observations_is_kept_too(tmp_path):
    actor = Actor(2, [-1.0], [1.0], features=3, depth=1, num_cells=8, preference_scale=2.0)
    save_module(actor, tmp_path / "policy.pt")
    inputs = torch.rand(5, 3), torch.rand(5, 2)
    assert torch.equal(load_module(tmp_path / "policy.pt")(*inputs), actor(*inputs))


def description(path):
    """What is said of a module, without the hash that tells whether it was changed."""
    content = json.loads(path.with_suffix(".json").read_text())
    del content["sha256_of_the_rest"]
    return content


@pytest.mark.parametrize("word", ["true", "14", "observation", "sha256"])
def test_a_changed_description_is_damaged(model, tmp_path, word):
    path = tmp_path / "reward.pt"
    save_module(model, path, {"passed": True, 2: (0.1, 14)})
    text = path.with_suffix(".json").read_text()
    for index in (match.start() for match in re.finditer(word, text)):
        path.with_suffix(".json").write_text(f"{text[:index]}{chr(ord(text[index]) ^ 1)}{text[index + 1 :]}")
        with pytest.raises(
            ValueError, match=r"reward\.json is damaged|reward\.json does not describe|hold the weights"
        ):
            load_module(path)
    path.with_suffix(".json").write_text(text)
    load_module(path)


def test_what_is_missing_or_damaged_is_named_in_one_sentence(model, tmp_path):
    path = tmp_path / "reward.pt"
    with pytest.raises(FileNotFoundError, match=r"^There is no .*\.$"):
        load_module(path)
    save_module(model, path)
    content = description(path)
    reward = content["model"]["model"]["models"][0]

    def describe(**changes):
        path.with_suffix(".json").write_text(json.dumps({**content, **changes}))

    describe(model={"_target_": "os.system", "command": "echo"})
    with pytest.raises(ValueError, match=r"names the foreign class os\.system; if it is your own"):
        load_module(path)
    describe(model={**reward, "depth": 3})
    with pytest.raises(ValueError, match="does not hold the weights"):
        load_module(path)
    describe(model={**reward, "height": 3})
    with pytest.raises(ValueError, match=r"describes a RewardModel that cannot be built: .*height"):
        load_module(path)
    describe()
    for damaged in (b"", b"nonsense", b"cos\nsystem\n(S'echo'\ntR."):
        path.write_bytes(damaged)
        for digest in (content["sha256"], hashlib.sha256(damaged).hexdigest()):
            describe(sha256=digest)
            with pytest.raises(ValueError, match="does not hold the weights"):
                load_module(path)
    torch.save(nn.Linear(2, 2), path)  # pickled code
    with pytest.raises(ValueError, match="does not hold the weights"):
        load_module(path)
    path.with_suffix(".json").write_text("{")
    with pytest.raises(ValueError, match="does not describe a saved module"):
        load_module(path)
    path.with_suffix(".json").unlink()
    with pytest.raises(FileNotFoundError, match=r"a saved module is two files, .*reward\.pt and reward\.json"):
        load_module(path)


@pytest.mark.parametrize(
    ("target", "sentence"),
    [
        ("torch.nn.Linear", "foreign class"),
        ("morlnav.modules.networks.torch.load", "is not there"),
        ("morlnav.modules.saved.import_module", "is no module of this package"),
        ("morlnav.modules.networks.check_bounds", "is no module of this package"),
        ("morlnav.modules.reward_model.nn.Linear", "is not there"),
        ("morlnav.modules.networks.Tensor", "is no module of this package"),
        ("morlnav.trainers.ray.RayCollector", "foreign class"),
    ],
)
@pytest.mark.parametrize("where", ["root", "features"])
def test_no_path_leads_to_foreign_code(model, tmp_path, target, sentence, where):
    path = tmp_path / "reward.pt"
    save_module(model, path)
    content = description(path)
    part = {"_target_": target}
    reward = content["model"]["model"]["models"][0]
    content["model"] = part if where == "root" else {**reward, "features": part}
    path.with_suffix(".json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=sentence):
        load_module(path)


def test_ones_own_classes_load_with_trust(tmp_path, monkeypatch):
    source = "from morlnav.modules import Actor\n\n\nclass Mine(Actor):\n    pass\n"
    (tmp_path / "my_networks.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    from my_networks import Mine

    save_module(Mine(2, [-1.0], [1.0], features=3, depth=1), tmp_path / "policy.pt")
    with pytest.raises(ValueError, match=r"foreign class my_networks\.Mine"):
        load_module(tmp_path / "policy.pt")
    assert type(load_module(tmp_path / "policy.pt", trust=True)) is Mine


def test_one_changed_bit_of_the_weights_is_noticed(model, tmp_path):
    path = tmp_path / "reward.pt"
    save_module(model, path)
    write_facts(path, {"more": "facts"})  # keep the hash
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"reward\.pt is damaged: it does not hold the weights that were saved"):
        load_module(path)


def test_what_could_not_be_loaded_again_is_not_saved(tmp_path):
    class Entry(nn.Module):
        pass

    with pytest.raises(ValueError, match=r"A Entry cannot be saved: it has no method config\(\)"):
        save_module(RewardEnsemble([Entry()]), tmp_path / "reward.pt")
    features = nn.Identity()
    features.out_features = 34
    with pytest.raises(ValueError, match="A Identity cannot be saved"):
        save_module(RewardModel(("observation",), **{**SMALL, "features": features}), tmp_path / "reward.pt")
    with pytest.raises(TypeError, match="not JSON serializable"):
        save_module(RewardModel(("observation",), **SMALL), tmp_path / "reward.pt", {"when": object()})
    assert not any(tmp_path.iterdir())
