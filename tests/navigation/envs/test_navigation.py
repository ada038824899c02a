"""The environment keeps TorchRL's contract with both engines, and starts, ends and observes as specified."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, ParallelEnv, SerialEnv, StepCounter, TransformedEnv, check_env_specs

from morlnav.data import UniformPreferences
from morlnav.navigation.envs import Efficiency, HumanDistance, NavigationEnv, Sum, default_objectives
from morlnav.navigation.world import PymunkWorld, Scene, SceneSampler, TensorWorld
from morlnav.transforms import DrawPreference

ENGINES = [TensorWorld, PymunkWorld]


def straight_scene(heading=0.0, goal=(8.0, 0.0), human=(4.0, 0.0), boxes=(), count=1):
    scene = Scene(
        start=torch.tensor([[0.0, 0.0, heading]]),
        goal=torch.tensor([goal]),
        human=torch.tensor([human]),
        boxes=torch.tensor(boxes).reshape(1, -1, 5),
        batch_size=[1],
    )
    return scene.expand(count).clone()


def forward(td, env, speed=0.5):
    return env.step(td.set("action", torch.tensor([speed, 0.0]).expand(*env.batch_size, 2)))


# TorchRL's contract


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("num_envs", [None, 1, 5])
@pytest.mark.parametrize("observe_human", [True, False])
def test_the_specs_hold(engine, num_envs, observe_human):
    check_env_specs(NavigationEnv(engine(), num_envs=num_envs, observe_human=observe_human, seed=0))


@pytest.mark.parametrize("engine", ENGINES)
def test_the_specs_hold_with_transforms_and_in_a_row(engine):
    def make():
        transforms = Compose(StepCounter(4), DrawPreference(UniformPreferences(2)))
        return TransformedEnv(NavigationEnv(engine(), num_envs=2), transforms)

    check_env_specs(make())
    check_env_specs(SerialEnv(2, make))


def test_the_specs_hold_in_processes():
    env = ParallelEnv(2, NavigationEnv)
    try:
        check_env_specs(env)
        env.set_seed(0)
        first = env.rollout(3)
        assert not torch.equal(first[0]["observation"], first[1]["observation"])
    finally:
        env.close(raise_if_closed=False)


@pytest.mark.parametrize("engine", ENGINES)
def test_one_seed_is_one_rollout(engine):
    def rollout(seed):
        env = NavigationEnv(engine(), num_envs=3)
        env.set_seed(seed)
        torch.manual_seed(0)
        return env.rollout(4, break_when_any_done=False)

    first, second, other = rollout(1), rollout(1), rollout(2)
    assert (first == second).all()
    assert not torch.equal(first["observation"], other["observation"])


def test_the_seed_may_be_given_at_once():
    env = NavigationEnv(num_envs=3, seed=5)
    again = NavigationEnv(num_envs=3)
    again.set_seed(5)
    assert torch.equal(env.reset()["observation"], again.reset()["observation"])


def test_the_global_seed_decides_where_none_is_given():
    def first():
        torch.manual_seed(11)
        return NavigationEnv(num_envs=3).reset()["observation"]

    assert torch.equal(first(), first())


@pytest.mark.parametrize("engine", ENGINES)
def test_a_partial_reset_leaves_the_others_alone(engine):
    env = NavigationEnv(engine(), num_envs=4, seed=0)
    td = forward(env.reset(), env)["next"]
    mask = torch.tensor([[True], [False], [True], [False]])
    before, scene = td.clone(), env.world.scene.clone()
    after = env.reset(td.set("_reset", mask))
    others = ~mask.squeeze(-1)
    for key in ("observation", "pose"):
        assert torch.equal(after[key][others], before[key][others]), key
        assert not torch.equal(after[key][~others], before[key][~others]), key
    assert (env.world.scene[others] == scene[others]).all()
    assert torch.equal(after["pose"][~others], env.world.scene.start[~others])
    assert not after["done"].any()


def test_resetting_ended_episodes_goes_on_with_new_ones():
    env = TransformedEnv(NavigationEnv(num_envs=6, seed=0), StepCounter(5))
    rollout = env.rollout(17, break_when_any_done=False)
    assert rollout["next", "truncated"][:, [4, 9, 14]].all()
    starts = rollout["pose"][:, [5, 10, 15], :2]
    assert (starts == 0).all()


def test_only_ended_episodes_draw_new_scenes():
    drawn = []

    def scenes(count, **arguments):
        drawn.append(count)
        return SceneSampler()(count, **arguments)

    env = NavigationEnv(scenes=scenes, num_envs=5, seed=0)
    td = env.reset()
    env.reset(td.set("_reset", torch.tensor([[False], [True], [False], [False], [True]])))
    assert drawn == [1, 5, 2]  # the first to see how many boxes there are
    second, fifth = env.world.scene[1], env.world.scene[4]
    generator = torch.Generator().manual_seed(0)
    SceneSampler()(5, generator=generator)
    following = SceneSampler()(2, generator=generator)
    assert (second == following[0]).all()
    assert (fifth == following[1]).all()


# Beginnings and ends


@pytest.mark.parametrize("engine", ENGINES)
def test_the_time_limit_truncates_and_contact_terminates(engine):
    env = TransformedEnv(NavigationEnv(engine(), num_envs=2), StepCounter(3))
    scenes = torch.cat([straight_scene(), straight_scene(human=(0.75, 0.0))])
    td = env.reset(scene=scenes)
    for step in range(3):
        following = forward(td, env)["next"]
        td = following.clone()
        if step == 2:
            break
        assert not following["truncated"].any()
    assert following["truncated"].flatten().tolist() == [True, True]
    assert following["terminated"].flatten().tolist() == [False, True]
    assert following["done"].all()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("goal", {"goal": (0.5, 0.0)}),
        ("human", {"human": (0.75, 0.0)}),
        ("box", {"boxes": [[0.6, 0.0, 0.2, 0.2, 0.0]]}),
    ],
)
def test_the_outcome_is_named(engine, name, changes):
    env = NavigationEnv(engine())
    td = env.reset(scene=straight_scene(**changes))
    for _ in range(4):
        following = forward(td, env)["next"]
        if following["done"]:
            break
        td = following
    assert following["terminated"]
    assert {key for key, value in following["outcome"].items() if value} == {name}


@pytest.mark.parametrize("shape", ["alone", "batched"])
def test_given_scenes_are_driven_in(shape):
    env = NavigationEnv(num_envs=None if shape == "alone" else 2)
    scene = straight_scene(heading=0.5, goal=(7.0, 1.0), count=2)
    env.reset(scene=scene[0] if shape == "alone" else scene)
    assert (env.world.scene.goal == torch.tensor([7.0, 1.0])).all()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"human": (8.0, 0.1)}, "The goal lies inside the human"),
        ({"human": (0.2, 0.0)}, "The start lies inside the human"),
        ({"boxes": [[0.3, 0.0, 0.2, 0.2, 0.0]]}, "The start lies inside a box"),
        ({"boxes": [[3.0, 0.0, 0.2, -0.2, 0.0]]}, "positive half sides"),
        ({"goal": (math.nan, 0.0)}, "must be finite"),
    ],
)
def test_impossible_scenes_are_refused(changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        NavigationEnv(num_envs=1).reset(scene=straight_scene(**changes))


def test_a_wrong_number_of_scenes_is_refused():
    with pytest.raises(ValueError, match="Got 3 scenes for 2 environments"):
        NavigationEnv(num_envs=2).reset(scene=straight_scene(count=3))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("num_boxes", [0, 5])
def test_any_number_of_boxes(engine, num_boxes):
    env = NavigationEnv(engine(), SceneSampler(num_boxes=num_boxes), num_envs=2, seed=0)
    check_env_specs(env)
    assert env.world.scene.boxes.shape == (2, num_boxes, 5)


@pytest.mark.parametrize("num_envs", [0, -1])
def test_there_is_at_least_one_environment(num_envs):
    with pytest.raises(ValueError, match="num_envs must be at least 1"):
        NavigationEnv(num_envs=num_envs)


# Observations and actions


@pytest.mark.parametrize("engine", ENGINES)
def test_the_observation_is_goal_human_and_scan_in_the_robots_frame(engine):
    env = NavigationEnv(engine())
    observation = env.reset(scene=straight_scene(heading=math.pi / 2, goal=(8.0, 0.0), human=(0.0, 2.0)))["observation"]
    assert observation.shape == (34,)
    assert observation.dtype == torch.float32
    # The robot looks along +y: the goal is to its right, the human straight ahead.
    torch.testing.assert_close(observation[:4], torch.tensor([8.0, -math.pi / 2, 2.0, 0.0]))
    scan = observation[4:]
    # Straight ahead is the boundary of sectors 14 and 15; sector 15 holds the ray at 0° itself.
    assert scan[15].item() == pytest.approx(1.7, abs=1e-3)
    assert scan[14].item() == pytest.approx(1.7, abs=2e-3)
    assert (scan[:13] == 4).all()
    assert (scan[17:] == 4).all()


def test_a_box_to_the_left_is_in_the_sectors_of_positive_angles():
    env = NavigationEnv()
    scan = env.reset(scene=straight_scene(human=(6.5, 2.0), boxes=[[0.0, 2.0, 0.5, 0.5, 0.0]]))["observation"][4:]
    left = int((math.pi / 2 + math.pi) / (2 * math.pi / 30))  # the sector of +90°
    assert scan[left].item() == pytest.approx(1.5, abs=1e-3)
    assert scan.argmin() == left
    assert (scan[:15] == 4).all()


def test_without_the_human_only_the_lidar_sees_it():
    with_human, without = NavigationEnv(num_envs=3, seed=1), NavigationEnv(num_envs=3, seed=1, observe_human=False)
    full, reduced = with_human.reset()["observation"], without.reset()["observation"]
    assert reduced.shape == (3, 32)
    assert torch.equal(reduced, torch.cat([full[:, :2], full[:, 4:]], -1))


def test_an_action_out_of_bounds_is_driven_as_far_as_the_robot_can():
    env = NavigationEnv(num_envs=2, seed=0)
    start = env.reset(scene=straight_scene(count=2))
    out = env.step(start.set("action", torch.tensor([[-5.0, 9.0], [20.0, 0.0]])))["next"]
    torch.testing.assert_close(env.world.pose, torch.tensor([[0.0, 0.0, 0.2 * torch.pi], [0.1, 0.0, 0.0]]))
    low, high = env.reward_bounds
    assert ((low <= out["reward"]) & (out["reward"] <= high)).all()


def test_seeding_an_environment_anew_leaves_the_global_random_state_alone():
    env, before = NavigationEnv(num_envs=2, seed=0), torch.get_rng_state()
    env.set_seed(None)
    assert torch.equal(torch.get_rng_state(), before)


def test_actions_are_metres_and_radians_per_second():
    spec = NavigationEnv().action_spec
    assert spec.space.low.tolist() == [0.0, pytest.approx(-math.pi)]
    assert spec.space.high.tolist() == [0.5, pytest.approx(math.pi)]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_state_goes_on_exactly(engine):
    def go_on(env, td):
        torch.manual_seed(3)
        return env.rollout(8, tensordict=td, auto_reset=False, break_when_any_done=False)

    make = lambda: TransformedEnv(NavigationEnv(engine(), num_envs=3, seed=0), StepCounter(6))  # noqa: E731
    env = make()
    td = forward(env.reset(), env)["next"].exclude("reward")
    state, start = env.base_env.get_state(), td.clone()
    expected = go_on(env, td)
    other = make()
    other.set_seed(99)
    other.reset()
    other.base_env.set_state(state)
    actual = go_on(other, start)
    tolerance = {"rtol": 0, "atol": 0} if engine is TensorWorld else {"rtol": 0, "atol": 1e-6}
    for key in ("observation", "pose", ("next", "reward"), ("next", "done")):
        torch.testing.assert_close(actual[key], expected[key], **tolerance)


def test_the_preference_may_change_in_mid_episode():
    env = TransformedEnv(NavigationEnv(num_envs=2, seed=0), DrawPreference(UniformPreferences(2)))
    td = forward(env.reset(TensorDict(preference=torch.eye(2), batch_size=[2])), env)["next"]
    assert torch.equal(td["preference"], torch.eye(2))
    td["preference"] = torch.full((2, 2), 0.5)
    following = forward(td, env)["next"]
    assert (following["preference"] == 0.5).all()
    assert not following["done"].any()


# Objectives


def test_objectives_keep_their_order_and_names():
    env = NavigationEnv()
    assert tuple(env.rewards) == ("baseline", "distance", "efficiency")
    assert env.objectives == ("distance", "efficiency")
    assert env.num_static == 1


def test_an_objective_of_ones_own_is_any_callable():
    class Calm:
        def __call__(self, transition):
            return -transition.action[..., 1].square()

    env = NavigationEnv(objectives={**default_objectives(), "calm": Calm()}, num_envs=2, seed=0)
    check_env_specs(env)
    td = env.reset()
    action = torch.tensor([[0.1, 2.0], [0.1, -3.0]])
    reward = env.step(td.set("action", action))["next", "reward"]
    assert reward.shape == (2, 4)
    assert reward[:, 3].tolist() == [-4.0, -9.0]
    assert env.objectives == ("distance", "efficiency", "calm")


def test_all_objectives_may_be_tuneable_or_static():
    assert NavigationEnv(objectives={"distance": HumanDistance()}).num_static == 0
    assert NavigationEnv(objectives={"efficiency": Sum([Efficiency()], static=True)}).objectives == ()


def test_static_objectives_come_first():
    wrong = {"distance": HumanDistance(), "baseline": Sum([Efficiency()], static=True)}
    with pytest.raises(ValueError, match=r"Static objectives must come before tuneable ones.*'distance', 'baseline'"):
        NavigationEnv(objectives=wrong)


def test_an_environment_without_objectives_is_refused():
    with pytest.raises(ValueError, match="at least one objective"):
        NavigationEnv(objectives={})


@pytest.mark.parametrize("world", [TensorWorld, PymunkWorld])
def test_a_state_that_is_set_goes_on_as_it_did(world):
    env = NavigationEnv(world(), num_envs=6, seed=0)
    went = env.rollout(8, break_when_any_done=False)
    step = went[:, 4]
    other = TransformedEnv(NavigationEnv(world(), num_envs=6, seed=9), StepCounter())
    other.reset()
    state = other.reset(step.select("pose", "scene"), set_state=True)
    assert torch.equal(state["observation"], step["observation"])
    again = other.step(state.set("action", step["action"]))["next"]
    for key in ("observation", "reward", "terminated", "pose"):
        assert torch.equal(again[key], step["next", key])


def test_a_state_that_lies_about_begins_no_episode():
    env = NavigationEnv(num_envs=3, seed=0)
    td = env.rollout(4)[:, -1]
    assert not torch.equal(env.reset(td.clone())["pose"], td["pose"])


def test_impossible_states_are_refused():
    env = NavigationEnv(num_envs=1, seed=0)
    td = env.reset()
    td["scene", "goal"].fill_(torch.nan)
    with pytest.raises(ValueError, match="goal must be finite"):
        env.reset(td, set_state=True)
