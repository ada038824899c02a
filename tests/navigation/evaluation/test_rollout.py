import pytest
import torch

from morlnav.navigation.envs import HumanDistance, NavigationEnv
from morlnav.navigation.evaluation import Outcome, evaluate_policy, evaluation_scenes
from morlnav.navigation.world import PymunkWorld, Scene, SceneSampler, TensorWorld


def seek(observation, preference):
    """Drives to the goal, past the human at a distance that the first objective asks for."""
    goal, human_distance, human = observation[:, 1], observation[:, 2], observation[:, 3]
    swerve = torch.where(human_distance < 2.5, (0.2 + preference[:, 0]) * (2.5 - human_distance), 0.0)
    turn = (2.0 * goal - swerve * human.cos().clamp_min(0)).clamp(-torch.pi, torch.pi)
    return torch.stack([0.5 * goal.cos().clamp(0.2, 1), turn], -1)


@pytest.fixture(scope="module")
def scenes():
    return evaluation_scenes(6, seed=3)


@pytest.fixture(scope="module")
def preferences():
    return torch.tensor([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])


@pytest.fixture(scope="module")
def rollouts(scenes, preferences):
    return evaluate_policy(seek, scenes, preferences, max_steps=150)


def test_matches_the_environment_stepped_episode_by_episode(rollouts, scenes, preferences):
    env = NavigationEnv(num_envs=1, seed=0)
    for p in range(3):
        for s in range(6):
            td = env.reset(scene=scenes[s : s + 1])
            for step in range(150):
                assert torch.allclose(rollouts.pose[p, s, step], td["pose"][0], atol=1e-4)
                assert torch.allclose(rollouts.clearance[p, s, step], td["observation"][0, 4:].min(), atol=1e-3)
                td["action"] = seek(td["observation"], preferences[p : p + 1])
                td = env.step(td)["next"]
                assert torch.allclose(rollouts.reward[p, s, step], td["reward"][0], atol=0.05)
                if td["done"]:
                    break
            assert rollouts.steps[p, s] == step + 1
            names = {Outcome.GOAL: "goal", Outcome.HUMAN: "human", Outcome.BOX: "box"}
            flags = {outcome: bool(td["outcome", name]) for outcome, name in names.items()}
            expected = next((outcome for outcome, flag in flags.items() if flag), Outcome.TIMEOUT)
            assert rollouts.outcome[p, s] == expected


def test_actions_are_limited_to_what_the_robot_can_do(scenes):
    too_fast, fastest = (
        evaluate_policy(lambda o, p, v=v: torch.tensor([[v, 0.0]]).expand(len(o), 2), scenes, torch.eye(2), max_steps=5)
        for v in (5.0, 0.5)
    )
    assert torch.equal(too_fast.pose, fastest.pose)
    assert torch.equal(too_fast.action, fastest.action)


class Timeless(TensorWorld):
    """A world that does not tell how long a step took."""

    def step(self, action):
        contact = super().step(action)
        contact.duration = None
        return contact


def test_a_world_need_not_measure_the_time_of_a_step(scenes):
    rollouts = evaluate_policy(seek, scenes, torch.eye(2), world=Timeless(), max_steps=5)
    assert torch.equal(rollouts.duration, rollouts.steps * 0.2)


def test_the_episodes_end_in_different_ways_and_lengths(rollouts):
    assert (rollouts.outcome == Outcome.GOAL).any()
    assert rollouts.steps.unique().numel() > 3


def test_padding_repeats_the_last_pose_and_pays_nothing(rollouts):
    p, s = (rollouts.steps == rollouts.steps.min()).nonzero()[0].tolist()
    n = rollouts.steps[p, s]
    assert n < rollouts.action.shape[2] == rollouts.steps.max()
    assert (rollouts.pose[p, s, n:] == rollouts.pose[p, s, n]).all()
    assert (rollouts.reward[p, s, n:] == 0).all()
    assert (rollouts.action[p, s, n:] == 0).all()
    assert len(rollouts.path[p][s]) == n + 1


def test_dropping_finished_episodes_changes_nothing(rollouts, scenes, preferences):
    full = evaluate_policy(seek, scenes, preferences, max_steps=150, drop_finished=False)
    assert torch.equal(full.outcome, rollouts.outcome)
    assert torch.equal(full.steps, rollouts.steps)
    assert torch.allclose(full.pose, rollouts.pose, atol=1e-4)
    assert torch.allclose(full.reward, rollouts.reward, atol=0.05)


def test_both_engines_agree():
    scenes, preferences = evaluation_scenes(2, seed=1), torch.eye(2)
    fast = evaluate_policy(seek, scenes, preferences, max_steps=60)
    slow = evaluate_policy(seek, scenes, preferences, max_steps=60, world=PymunkWorld())
    assert torch.equal(fast.outcome, slow.outcome)
    assert torch.allclose(fast.pose, slow.pose, atol=0.02)


def test_neither_random_state_nor_a_borrowed_world_is_disturbed(scenes):
    env = NavigationEnv(num_envs=4, seed=0)
    env.reset()
    pose, scene, random = env.world.pose.clone(), env.world.scene, torch.get_rng_state()

    def noisy(observation, preference):
        return torch.rand(len(observation), 2)

    evaluate_policy(noisy, scenes, torch.eye(2), world=env.world, max_steps=3)
    assert torch.equal(random, torch.get_rng_state())
    assert torch.equal(env.world.pose, pose)
    assert env.world.scene is scene


def test_no_gradient_is_recorded(scenes):
    weight = torch.ones(2, requires_grad=True)
    rollouts = evaluate_policy(lambda o, p: weight.expand(len(o), 2) * 0.1, scenes, torch.eye(2), max_steps=2)
    assert not rollouts.reward.requires_grad


def test_without_the_human_the_policy_sees_32_numbers(scenes):
    widths = set()

    def blind(observation, preference):
        widths.add((observation.shape[1], preference.shape[1]))
        return torch.zeros(len(observation), 2)

    terms = {"distance": HumanDistance()}
    rollouts = evaluate_policy(blind, scenes, torch.ones(1, 1), objectives=terms, observe_human=False, max_steps=2)
    assert widths == {(32, 1)}
    assert rollouts.reward.shape == (1, 6, 2, 1)
    assert (rollouts.outcome == Outcome.TIMEOUT).all()


def test_contacts_are_told_apart():
    box = torch.tensor([[[2.0, 0.0, 0.3, 0.3, 0.0]], [[2.0, 3.0, 0.3, 0.3, 0.0]], [[2.0, 3.0, 0.3, 0.3, 0.0]]])
    human = torch.tensor([[3.0, 3.0], [3.0, 0.0], [3.0, 3.0]])
    goal = torch.tensor([[6.0, 0.0]]).expand(3, 2)
    scene = Scene(start=torch.zeros(3, 3), goal=goal, human=human, boxes=box, batch_size=[3])
    straight = evaluate_policy(lambda o, p: torch.tensor([[0.5, 0.0]]).expand(len(o), 2), scene, torch.eye(2))
    assert straight.outcome.tolist() == [[Outcome.BOX, Outcome.HUMAN, Outcome.GOAL]] * 2
    # 6 - 0.35 = 5.65 m at 0.1 m a step.
    assert straight.steps[0, 2] == 57


def test_evaluation_scenes_repeat_and_differ_from_training_scenes():
    first, again = evaluation_scenes(5, seed=7), evaluation_scenes(5, seed=7)
    training = SceneSampler()(5, generator=torch.Generator().manual_seed(7))
    assert torch.equal(first.boxes, again.boxes)
    assert not torch.equal(first.boxes, training.boxes)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"preferences": torch.eye(3)}, "tuneable objective"),
        ({"preferences": torch.ones(2)}, "tuneable objective"),
        ({"max_steps": 0}, "max_steps"),
        ({"scenes": evaluation_scenes(2).reshape(1, 2)}, "one batch dimension"),
    ],
)
def test_wrong_arguments_are_explained(scenes, arguments, message):
    arguments = {"scenes": scenes, "preferences": torch.eye(2), **arguments}
    with pytest.raises(ValueError, match=message):
        evaluate_policy(seek, world=TensorWorld(), **arguments)


def test_wrong_scene_requests_are_explained():
    with pytest.raises(ValueError, match="at least one scene"):
        evaluation_scenes(0)
    with pytest.raises(ValueError, match="seed"):
        evaluation_scenes(1, seed=-1)
