"""Where a step ends: at the human, at a box, at the goal; the same in both engines."""

import math

import pytest
import torch

from morlnav.navigation.world import PymunkWorld, Scene, TensorWorld

FORWARD = torch.tensor([[0.5, 0.0]])


@pytest.fixture(params=[TensorWorld, PymunkWorld])
def engine(request):
    return request.param


def face(engine, human=(50.0, 0.0), boxes=(), goal=(90.0, 0.0), **arguments):
    """A world whose robot stands in the origin and looks along x."""
    world = engine(**arguments)
    world.reset(
        Scene(
            start=torch.zeros(1, 3),
            goal=torch.tensor([goal]),
            human=torch.tensor([human]),
            boxes=torch.tensor(boxes).reshape(1, -1, 5),
            batch_size=[1],
        )
    )
    return world


def drive(world, steps):
    for _ in range(steps):
        contact = world.step(FORWARD)
        if contact.human or contact.box or contact.goal:
            break
    return world.pose[0, 0].item(), {name for name in ("human", "box", "goal") if getattr(contact, name)}


def test_an_open_road_is_driven_to_the_full(engine):
    x, met = drive(face(engine), 10)
    assert x == pytest.approx(1.0, abs=1e-5)
    assert met == set()


def test_the_robot_stops_at_the_first_check_point_where_it_touches_the_human(engine):
    # Touching at x = 1.01 - 0.48 = 0.53; check points lie 0.025 m apart.
    x, met = drive(face(engine, human=(1.01, 0.0)), 10)
    assert x == pytest.approx(0.55, abs=1e-5)
    assert met == {"human"}


def test_the_robot_stops_at_the_side_of_a_box(engine):
    # Touching at x = 1.0 - 0.3 - 0.18 = 0.52.
    x, met = drive(face(engine, boxes=[[1.0, 0.1, 0.3, 0.4, 0.0]]), 10)
    assert x == pytest.approx(0.525, abs=1e-5)
    assert met == {"box"}


def test_a_boxs_corner_is_round_to_the_robot(engine):
    # The corner at (1, 0.1) is touched at x = 1 - sqrt(0.18² - 0.1²) = 0.8503.
    x, met = drive(face(engine, boxes=[[1.5, 0.6, 0.5, 0.5, 0.0]]), 10)
    assert x == pytest.approx(0.875, abs=1e-5)
    assert met == {"box"}


def test_a_turned_box_is_met_at_its_tip(engine):
    x, met = drive(face(engine, boxes=[[1.5, 0.0, 0.5, 0.5, math.pi / 4]]), 10)
    assert x == pytest.approx(math.ceil((1.5 - math.sqrt(0.5) - 0.18) / 0.025) * 0.025, abs=1e-5)
    assert met == {"box"}


def test_the_goal_ends_a_step_within_its_disc(engine):
    x, met = drive(face(engine, goal=(0.91, 0.0)), 10)
    assert x == pytest.approx(0.575, abs=1e-5)
    assert met == {"goal"}


def test_a_collision_at_the_goal_is_no_arrival(engine):
    # The goal is reached from x = 0.59 on, the corner at (0.75, 0.05) is touched from x = 0.577 on.
    x, met = drive(face(engine, goal=(0.94, 0.0), boxes=[[1.0, 0.3, 0.25, 0.25, 0.0]]), 10)
    assert x == pytest.approx(0.6, abs=1e-5)
    assert met == {"box"}


def test_a_near_miss_is_no_contact(engine):
    _, met = drive(face(engine, human=(0.5, 0.485), boxes=[[0.5, -0.485, 0.3, 0.3, 0.0]]), 10)
    assert met == set()


def test_contact_is_checked_as_often_as_asked(engine):
    x, _ = drive(face(engine, human=(1.01, 0.0), check_interval=0.2), 10)
    assert x == pytest.approx(0.6, abs=1e-5)
    x, _ = drive(face(engine, human=(1.01, 0.0), check_interval=0.01), 10)
    assert x == pytest.approx(0.53, abs=0.0051)


@pytest.mark.parametrize("name", ["human_radius", "goal_radius", "step_time", "check_interval"])
def test_a_world_without_size_or_time_is_refused(engine, name):
    with pytest.raises(ValueError, match=f"{name} must be positive"):
        engine(**{name: 0.0})
