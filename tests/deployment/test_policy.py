"""A trained policy loads as a plain module, from weights alone, and from nobody's classes but our own."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from support import assert_identical, configure
from torchrl.checkpoint import CheckpointRotation

import morlnav
from morlnav.deployment.policy import Policy
from morlnav.runs import make_training

FILES = ("policy.pt", "policy.json")
DEFAULT = Path(__file__).parents[2] / "results" / "default"


@pytest.fixture
def copied_run(smoke_run, tmp_path):
    for name in FILES:
        shutil.copy(smoke_run / name, tmp_path)
    return tmp_path


def change_description(directory, change):
    """``change`` what a policy says that it is, as nested dictionaries."""
    file = directory / "policy.json"
    content = json.loads(file.read_text())
    change(content)
    del content["sha256_of_the_rest"]  # or it would tell of the change
    file.write_text(json.dumps(content))


def observations(*batch):
    return 3 * torch.rand(*batch, 34)


def test_a_policy_is_a_plain_module_in_evaluation_mode(smoke_run):
    policy = morlnav.load(smoke_run)
    assert isinstance(policy, torch.nn.Module)
    assert not policy.training
    assert not any(parameter.requires_grad for parameter in policy.parameters())
    assert policy.objectives == ("distance", "efficiency")


def test_weights_and_their_description_are_all_that_driving_needs(tmp_path):
    for name in FILES:
        shutil.copy(Path(__file__).parents[2] / "results/default" / name, tmp_path)
    policy = morlnav.load(tmp_path)
    assert policy.objectives == ("demo", "distance", "efficiency")
    assert policy(observations(2), torch.eye(3)[:2]).shape == (2, 2)


@pytest.mark.parametrize("batch", [(), (1,), (7,), (3, 5)], ids=str)
def test_actions_keep_the_batch_and_the_bounds(smoke_run, batch):
    action = morlnav.load(smoke_run)(observations(*batch), torch.rand(*batch, 2).softmax(-1))
    assert action.shape == (*batch, 2)
    assert ((action >= torch.tensor([0, -torch.pi])) & (action <= torch.tensor([0.5, torch.pi]))).all()


def test_one_preference_serves_many_observations(smoke_run):
    policy, observation, preference = morlnav.load(smoke_run), observations(6), torch.tensor([0.25, 0.75])
    torch.testing.assert_close(policy(observation, preference), policy(observation, preference.expand(6, 2)))


@pytest.mark.parametrize(
    "kind", [list, np.array, torch.Tensor.double, torch.Tensor.half], ids=["list", "array", 64, 16]
)
def test_any_real_numbers_will_do(smoke_run, kind):
    policy, observation, preference = morlnav.load(smoke_run), torch.full((34,), 0.5), torch.tensor([0.25, 0.75])
    torch.testing.assert_close(policy(kind(observation), kind(preference)), policy(observation, preference))


GOOD = (torch.zeros(4, 34), torch.tensor([0.5, 0.5]))


@pytest.mark.parametrize(
    ("inputs", "sentence"),
    [
        ((torch.zeros(33), GOOD[1]), r"Expected observations \[..., 34\], got \(33,\)"),
        ((torch.tensor(1.0), GOOD[1]), r"must fit, got \[\] and \[2\]"),
        ((GOOD[0], torch.full((3, 2), 0.5)), r"must fit, got \[4, 34\] and \[3, 2\]"),
        ((GOOD[0][0], torch.full((3, 2), 0.5)), r"must fit, got \[34\] and \[3, 2\]"),
        ((GOOD[0], torch.tensor(1.0)), "A preference needs 2 entries"),
        ((GOOD[0].bool(), GOOD[1]), "Observations must be real numbers, got bool"),
        (({"observation": GOOD[0]}, GOOD[1]), "Observations must be a tensor of numbers, got dict"),
        ((GOOD[0], "calm"), "Preferences must be a tensor of numbers, got str"),
        (([[0.0] * 34, [0.0]], GOOD[1]), "Observations must be a tensor of numbers, got list"),
    ],
    ids=range(9),
)
def test_inputs_of_another_shape_or_kind_are_named(smoke_run, inputs, sentence):
    with pytest.raises(ValueError, match=sentence) as error:
        morlnav.load(smoke_run)(*inputs)
    assert "\n" not in str(error.value)


def test_the_preference_matters_to_the_action(smoke_run):
    policy, observation = morlnav.load(smoke_run), observations(6)
    one, other = torch.eye(2)
    assert (policy(observation, one) != policy(observation, other)).any()


def test_it_is_the_refined_average_not_the_last_actor(smoke_run, tmp_path):
    training = make_training(configure())
    trainer = training.make_trainer(tmp_path)
    trainer.load_from_file(CheckpointRotation(smoke_run / "checkpoints", keep_last=1).latest())
    loaded = morlnav.load(smoke_run).actor.state_dict()
    assert_identical(loaded, training.finish(trainer).state_dict())
    average = trainer.checkpoint.components["average"].module.state_dict()
    assert any(not torch.equal(loaded[name], average[name]) for name in loaded)
    last = trainer.loss_module.actor_network_params
    weights = last.flatten_keys(".").to_dict()
    assert any(not torch.equal(loaded[name], weights[f"module.{name}"]) for name in loaded if "weight" in name)


def test_the_file_holds_weights_and_nothing_else(smoke_run):
    weights = torch.load(smoke_run / "policy.pt", weights_only=True)
    assert all(isinstance(value, torch.Tensor) for value in weights.values())


def test_a_wrong_preference_is_named(smoke_run):
    with pytest.raises(ValueError, match=r"needs 2 entries \('distance', 'efficiency'\)"):
        morlnav.load(smoke_run)(observations(3), torch.rand(3, 3))


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_an_observation_that_is_not_finite_is_refused(smoke_run, value):
    observation = observations(3)
    observation[1, 7] = value
    with pytest.raises(ValueError, match=f"Observations must be finite, got {value} in entry 7"):
        morlnav.load(smoke_run)(observation, torch.tensor([0.5, 0.5]))


@pytest.mark.parametrize(
    "preference", [[5.0, -4.0], [0.5, 0.6], [0.0, 0.0], [torch.nan, 0.5], [torch.inf, 0.0]], ids=str
)
@pytest.mark.parametrize("batch", [(), (3,), (2, 3)], ids=str)
def test_a_preference_off_the_simplex_is_refused(smoke_run, preference, batch):
    rows = torch.tensor([1.0, 0.0]).repeat(*batch, 1) if batch else torch.zeros(2)
    rows.view(-1, 2)[-1] = torch.tensor(preference)
    with pytest.raises(ValueError, match=r"must be at least 0 and add up to 1, got \[") as error:
        morlnav.load(smoke_run)(observations(*batch), rows)
    assert str(preference[0]) in str(error.value)


def test_a_preference_may_be_rounded(smoke_run):
    policy = morlnav.load(smoke_run)
    assert policy(observations(2), torch.tensor([0.333, 0.6665])).isfinite().all()


def test_an_action_that_is_not_finite_is_refused():
    policy = Policy(lambda observation, preference: observation[..., :2].exp(), ("distance", "efficiency"))
    assert policy(torch.zeros(34), torch.tensor([1.0, 0.0])).tolist() == [1, 1]
    with pytest.raises(ValueError, match=r"The action must be finite, got \[inf, inf\] of huge observations"):
        policy(torch.full((34,), 100.0), torch.tensor([1.0, 0.0]))


def test_compiled_it_answers_with_a_stop_what_it_would_refuse(smoke_run):
    policy, preference = morlnav.load(smoke_run), torch.tensor([[0.25, 0.75]] * 3)
    observation, compiled = observations(3), torch.compile(policy, backend="eager")
    torch.testing.assert_close(compiled(observation, preference), policy(observation, preference))
    observation[1, 5], preference[2] = torch.nan, torch.tensor([5.0, -4.0])
    action = compiled(observation, preference)
    torch.testing.assert_close(action[0], policy(observation[0], preference[0]))
    assert action[1:].tolist() == [[0, 0], [0, 0]]


def test_foreign_classes_are_refused_without_trust(copied_run):
    change_description(copied_run, lambda content: content["model"].update(_target_="os.system"))
    with pytest.raises(ValueError, match=r"foreign class os\.system; if it is your own, load it with trust=True"):
        morlnav.load(copied_run)


@pytest.mark.parametrize("damage", [b"", b"PK no weights"])
def test_damaged_weights_are_named(copied_run, damage):
    (copied_run / "policy.pt").write_bytes(damage)
    with pytest.raises(ValueError, match=r"policy\.pt is damaged: it does not hold the weights that were saved"):
        morlnav.load(copied_run)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"model": 3}', '{"model": {"_target_": "a.B"}}'])
def test_a_damaged_description_is_named(copied_run, text):
    (copied_run / "policy.json").write_text(text)
    with pytest.raises(ValueError, match=r"policy\.json does not describe a saved module"):
        morlnav.load(copied_run)


def test_a_policy_without_objectives_is_damaged(copied_run):
    change_description(copied_run, lambda content: content["facts"].clear())
    with pytest.raises(ValueError, match=r"policy\.json is damaged: it names no objectives"):
        morlnav.load(copied_run)


def test_ones_own_classes_load_with_trust(copied_run, monkeypatch):
    (copied_run / "my_networks.py").write_text("from morlnav.modules import Actor\n\n\nclass Mine(Actor):\n    pass\n")
    monkeypatch.syspath_prepend(copied_run)
    change_description(copied_run, lambda content: content["model"].update(_target_="my_networks.Mine"))
    policy = morlnav.load(copied_run, trust=True)
    assert isinstance(policy, Policy)
    assert type(policy.actor).__name__ == "Mine"


@pytest.mark.parametrize(
    ("missing", "sentence"),
    [("policy.pt", r"holds no policy\.pt: no run has finished there"), ("policy.json", r"made by morlnav 0\.1")],
)
def test_a_missing_file_is_named_in_one_sentence(copied_run, missing, sentence):
    (copied_run / missing).unlink()
    with pytest.raises((FileNotFoundError, ValueError), match=sentence) as error:
        morlnav.load(copied_run)
    assert "\n" not in str(error.value)


def test_balance_moves_what_lies_between_styles_and_keeps_pure_ones():
    plain, even = morlnav.load(DEFAULT), morlnav.load(DEFAULT, balance={"demo": 0.25})
    observation, pure = observations(3), torch.eye(3)
    assert torch.equal(even(observation, pure), plain(observation, pure))
    asked, answered = torch.tensor([0.8, 0.2, 0.0]), torch.tensor([0.5, 0.5, 0.0])
    torch.testing.assert_close(even(observation, asked), plain(observation, answered))
    with pytest.raises(ValueError, match="add up to 1"):
        even(observation, 2 * asked)


def test_balance_keeps_the_sum_of_a_rounded_preference_and_none_is_like_all_equal():
    policies = [morlnav.load(DEFAULT, balance=balance) for balance in (None, {}, {"default": 2.0})]
    plain, *equal = (policy(torch.ones(34), torch.tensor([0.333, 0.333, 0.333])) for policy in policies)
    for action in equal:
        torch.testing.assert_close(action, plain)


@pytest.mark.parametrize(
    ("balance", "sentence"),
    [
        ({"dem": 0.5}, "balance names dem, which is none of: demo, distance, efficiency"),
        ({"demo": 0.0}, "balance must be positive and finite"),
        ({"demo": float("nan")}, "balance must be positive and finite"),
        ({"demo": float("inf")}, "balance must be positive and finite"),
        ({"demo": "much"}, "balance must give numbers by objective, such as {'demo': 0.3}, got {'demo': 'much'}"),
        (0.3, "balance must give numbers by objective"),
    ],
)
def test_a_wrong_balance_is_named(balance, sentence):
    with pytest.raises(ValueError, match=sentence):
        morlnav.load(DEFAULT, balance=balance)
