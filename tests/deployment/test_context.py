"""Rooms choose the preference; changes are smooth and may come in the middle of an episode."""

import argparse
import math

import pandas as pd
import pytest
import torch

import morlnav
from morlnav.commands.evaluate import evaluate_route, parse_stop
from morlnav.deployment.context import ContextPolicy, load_contexts
from morlnav.deployment.policy import Policy
from morlnav.navigation.evaluation import evaluate_policy, evaluation_scenes
from morlnav.runs import Run

OBJECTIVES = ("distance", "efficiency")
ROOMS = {"kitchen": torch.tensor([1.0, 0.0]), "corridor": torch.tensor([0.0, 1.0])}


def write(tmp_path, text):
    file = tmp_path / "rooms.yaml"
    file.write_text(text)
    return file


def robot(**options):
    return ContextPolicy(Policy(lambda observation, preference: preference, OBJECTIVES), ROOMS, **options)


def test_weights_are_normalised_and_missing_ones_are_zero(tmp_path):
    rooms = load_contexts(write(tmp_path, "hall: {efficiency: 4}\noffice: {distance: 1, efficiency: 3}"), OBJECTIVES)
    assert {name: weights.tolist() for name, weights in rooms.items()} == {"hall": [0, 1], "office": [0.25, 0.75]}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("hall: {speed: 1}", "hall in .* names speed, which is no objective; choose from: distance, efficiency"),
        ("hall: {distance: -1}", "gives distance the weight -1"),
        ("hall: {distance: true}", "gives distance the weight True"),
        ("hall: {distance: .inf}", "gives distance the weight inf"),
        ("hall: {distance: 0}", "needs a weight above 0"),
        ("hall: 3", "must map rooms to weights"),
        ("- hall", "must map rooms to weights"),
        ("", "must map rooms to weights"),
        ("hall: {", "not readable as YAML"),
    ],
)
def test_mistakes_in_the_file_are_named(tmp_path, text, sentence):
    with pytest.raises(ValueError, match=sentence):
        load_contexts(write(tmp_path, text), OBJECTIVES)


@pytest.mark.parametrize(
    "text",
    [
        "hunter2",
        "root:hunter2:0:0",
        "password: hunter2",
        "password: {distance: hunter2}",
        "hall: {distance: '${oc.env:SECRET}'}",
        "hall: {distance: [hunter2]}",
        "hall: [hunter2",
        "hall: {distance: 1}\n\thunter2",
        "${hunter2",
        "!!python/object/apply:os.system [hunter2]",
        "hall: *hunter2",
        "- hunter2",
        "2",
    ],
)
def test_a_foreign_file_is_refused_without_its_content(tmp_path, monkeypatch, text):
    monkeypatch.setenv("SECRET", "hunter2")
    with pytest.raises(ValueError, match=r"rooms\.yaml") as error:
        load_contexts(write(tmp_path, text), OBJECTIVES)
    assert "hunter2" not in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no file of contexts"):
        load_contexts(tmp_path / "rooms.yaml", OBJECTIVES)


def test_the_preference_follows_an_exponential_and_stays_on_the_simplex():
    driver = robot(time_constant=1.0, step_time=0.2)
    driver.enter("corridor")
    for step in range(1, 11):
        preference = driver(torch.zeros(3, 34))
        torch.testing.assert_close(preference[:, 0], torch.full((3,), math.exp(-0.2 * step)))
        torch.testing.assert_close(preference.sum(-1), torch.ones(3))


def test_without_a_time_constant_the_change_is_at_once():
    driver = robot(time_constant=0)
    driver.enter("corridor")
    assert driver(torch.zeros(34)).tolist() == [0, 1]


def test_a_schedule_is_what_the_robot_would_do():
    driver = robot(time_constant=0.5)
    schedule = driver.schedule({0: "kitchen", 0.6: "corridor"}, 6)
    driven = []
    for step in range(6):
        if step == 3:
            driver.enter("corridor")
        driven.append(driver(torch.zeros(34)))
    torch.testing.assert_close(schedule, torch.stack(driven))


def test_unknown_rooms_and_routes_are_refused():
    with pytest.raises(ValueError, match="no room cellar; choose from: kitchen, corridor"):
        robot().enter("cellar")
    with pytest.raises(ValueError, match="begins at 0 seconds"):
        robot().schedule({1.0: "kitchen"}, 3)
    with pytest.raises(ValueError, match="one entry for each of"):
        ContextPolicy(Policy(torch.nn.Identity(), ("one",)), ROOMS)


def test_a_schedule_changes_the_preference_in_mid_episode():
    seen = []

    def policy(observation, preference):
        seen.append(preference[0].tolist())
        return torch.tensor([0.1, 0.0]).expand(len(observation), 2)

    schedules = torch.tensor([[[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    evaluate_policy(policy, evaluation_scenes(1), schedules, max_steps=5)
    assert seen == [[1, 0], [1, 0], [0, 1], [0, 1], [0, 1]]


def test_a_constant_schedule_is_a_fixed_preference(smoke_run):
    policy, scenes = morlnav.load(smoke_run), evaluation_scenes(3)
    fixed = evaluate_policy(policy, scenes, torch.eye(2), max_steps=20)
    scheduled = evaluate_policy(policy, scenes, torch.eye(2).unsqueeze(1).expand(2, 7, 2), max_steps=20)
    torch.testing.assert_close(fixed.pose, scheduled.pose, rtol=0, atol=0)


def test_a_route_is_evaluated_beside_its_rooms(smoke_run, tmp_path):
    file = write(tmp_path, "kitchen: {distance: 1}\ncorridor: {efficiency: 1}")
    run = Run(smoke_run, changes={"episodes": 2})
    rooms = pd.read_csv(evaluate_route(run, file, {0: "corridor", 4: "kitchen"}, tmp_path))
    assert rooms["room"].tolist() == ["kitchen", "corridor", "corridor from 0 s, kitchen from 4 s"]
    assert rooms["episodes"].tolist() == [2, 2, 2]


@pytest.mark.parametrize("word", ["kitchen", "kitchen:6", "6:", ":kitchen"])
def test_a_stop_without_time_or_room_is_refused(word):
    with pytest.raises(argparse.ArgumentTypeError, match="is no SECOND:ROOM"):
        parse_stop(word)
