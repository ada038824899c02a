"""Scenes: what the sampler promises, and which scenes are refused."""

import pytest
import torch
from shapely import Point, affinity
from shapely import box as rectangle

from morlnav.navigation.world import Scene, SceneSampler, TensorWorld


def make_scene(**changes):
    parts = {
        "start": torch.zeros(1, 3),
        "goal": torch.tensor([[8.0, 0.0]]),
        "human": torch.tensor([[4.0, 0.0]]),
        "boxes": torch.tensor([[[2.0, 2.0, 0.5, 0.5, 0.3]]]),
    }
    return Scene(**(parts | {name: torch.tensor([value]) for name, value in changes.items()}), batch_size=[1])


def polygon(box):
    x, y, half_length, half_width, angle = box
    shape = rectangle(-half_length, -half_width, half_length, half_width)
    return affinity.translate(affinity.rotate(shape, angle, origin=(0, 0), use_radians=True), x, y)


def test_boxes_keep_clear_of_start_goal_and_human():
    scene = SceneSampler()(300, generator=torch.Generator().manual_seed(0))
    for start, goal, human, boxes in zip(
        scene.start.tolist(), scene.goal.tolist(), scene.human.tolist(), scene.boxes.tolist(), strict=True
    ):
        for box in map(polygon, boxes):
            assert box.distance(Point(start[:2])) >= 0.6 - 1e-5
            assert box.distance(Point(goal)) >= 0.6 - 1e-5
            assert box.distance(Point(human)) >= 0.8 - 1e-5


def test_scenes_look_as_the_paper_says():
    scene = SceneSampler()(2000, generator=torch.Generator().manual_seed(1))
    length = (scene.goal - scene.start[:, :2]).norm(dim=-1)
    assert 6 <= length.min() < 6.1
    assert 11.9 < length.max() <= 12
    torch.testing.assert_close(scene.human, (scene.goal + scene.start[:, :2]) / 2)
    assert 0.75 < scene.start[:, 2].abs().max() <= torch.pi / 4
    assert scene.boxes[..., 2:4].min() >= 0.2
    assert scene.boxes[..., 2:4].max() <= 0.6
    assert scene.boxes[..., 1].abs().max() <= 3
    assert (scene.boxes[..., 0] >= 0).all()
    assert (scene.boxes[..., 0] <= length[:, None]).all()


def test_one_generator_state_gives_one_set_of_scenes():
    sampler = SceneSampler()
    generator = torch.Generator().manual_seed(7)
    first, second = sampler(20, generator=generator), sampler(20, generator=generator)
    again = sampler(20, generator=torch.Generator().manual_seed(7))
    assert (first == again).all()
    assert not (first.boxes == second.boxes).any()


@pytest.mark.parametrize("num_boxes", [0, 1, 6])
def test_any_number_of_boxes_can_be_drawn(num_boxes):
    scene = SceneSampler(num_boxes=num_boxes)(5)
    assert scene.boxes.shape == (5, num_boxes, 5)
    scene.check()


def test_boxes_that_fit_nowhere_are_refused():
    with pytest.raises(ValueError, match="cannot be placed clear of start, goal and human"):
        SceneSampler(box_half_side=(9.0, 9.0))(2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"distance": (6.0, 5.0)}, "distance needs 0 < low <= high"),
        ({"box_half_side": (0.0, 1.0)}, "box_half_side needs 0 < low <= high"),
        ({"num_boxes": -1}, "num_boxes must not be negative"),
    ],
)
def test_senseless_ranges_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        SceneSampler(**arguments)


IMPOSSIBLE = [
    ({"boxes": [[0.6, 0.0, 0.5, 0.5, 0.0]]}, "The start lies inside a box"),
    ({"boxes": [[8.3, 0.0, 0.5, 0.5, 0.0]]}, "The goal lies inside a box"),
    ({"boxes": [[2.0, 2.0, 0.0, 0.5, 0.0]]}, "Every box needs positive half sides"),
    ({"human": [0.4, 0.0]}, "The start lies inside the human"),
    ({"human": [8.2, 0.0]}, "The goal lies inside the human"),
    ({"goal": [float("nan"), 0.0]}, "goal must be finite"),
    ({"start": [0.0, 0.0]}, "start needs 3 numbers in its last dimension, got 2"),
    ({"boxes": [[2.0, 2.0, 0.5, 0.5]]}, "boxes needs 5 numbers in its last dimension, got 4"),
]


@pytest.mark.parametrize(("changes", "message"), IMPOSSIBLE)
def test_impossible_scenes_are_refused_in_one_sentence(changes, message):
    with pytest.raises(ValueError, match=message) as error:
        make_scene(**changes).check()
    assert "\n" not in str(error.value)


def test_a_world_refuses_an_impossible_scene_and_stays_as_it_was():
    world = TensorWorld()
    with pytest.raises(ValueError, match="The start lies inside the human"):
        world.reset(make_scene(human=[0.4, 0.0]))
    assert world.scene is None
    world.reset(make_scene())


def test_a_world_checks_with_its_own_radii():
    scene = make_scene(human=[0.6, 0.0])
    TensorWorld().reset(scene)
    with pytest.raises(ValueError, match="The start lies inside the human"):
        TensorWorld(human_radius=0.5).reset(scene)
