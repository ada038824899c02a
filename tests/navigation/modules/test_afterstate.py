import torch
from support import configure

from morlnav.modules import VectorCritic
from morlnav.navigation.evaluation import evaluation_scenes
from morlnav.navigation.modules import AfterstateFeatures, NavigationFeatures
from morlnav.navigation.world import DifferentialDrive, TensorWorld
from morlnav.runs import make_training
from morlnav.trainers import live_objects

SIZES = {"action_low": [0.0, -3.14], "action_high": [0.5, 3.14], "features": NavigationFeatures()}


def driven(steps=20, **settings):
    """Observations before and after a random action, where no contact cut the step short."""
    generator = torch.Generator().manual_seed(0)
    world = TensorWorld(**settings)
    world.reset(evaluation_scenes(100, 3))
    low, high = world.robot.action_low, world.robot.action_high
    for _ in range(steps):
        before = world.observe()
        action = low + (high - low) * torch.rand(100, 2, generator=generator)
        contact = world.step(action)
    free = ~(contact.goal | contact.human | contact.box)
    return before[free], action[free], world.observe()[free]


def test_goal_and_human_are_where_the_world_shows_them():
    before, action, after = driven()
    module = AfterstateFeatures()
    predicted = module.predict(before, module.motion(action))
    assert len(before) > 50
    torch.testing.assert_close(predicted[:, ::2], after[:, [0, 2]], atol=1e-5, rtol=0)
    apart = predicted[:, 1::2] - after[:, [1, 3]]
    assert torch.atan2(apart.sin(), apart.cos()).abs().max() < 1e-4


def test_its_features_are_those_of_the_observation_to_come():
    before, action, after = driven()
    expected = NavigationFeatures(use_lidar=False, octaves=4)(after)
    torch.testing.assert_close(AfterstateFeatures()(before, action), expected, atol=1e-4, rtol=0)


def test_it_knows_another_robot_and_another_pace():
    settings = {"robot": DifferentialDrive(max_speed=1.5, max_turn=1.0), "step_time": 0.5}
    before, action, after = driven(4, **settings)
    one, other = AfterstateFeatures(**settings), AfterstateFeatures()
    distance = one.predict(before, one.motion(action))[:, 0]
    torch.testing.assert_close(distance, after[:, 0], atol=1e-5, rtol=0)
    assert (other.predict(before, other.motion(action))[:, 0] - after[:, 0]).abs().max() > 0.01


def test_without_the_human_only_the_goal_is_moved():
    before, action, _ = driven()
    blind = torch.cat([before[:, :2], before[:, 4:]], -1)
    motion = AfterstateFeatures().motion(action)
    predicted = AfterstateFeatures(observe_human=False).predict(blind, motion)
    assert torch.equal(predicted, AfterstateFeatures().predict(before, motion)[:, :2])


def test_clearance_is_the_nearest_reading_of_the_scan_to_come():
    before, action, after = driven()
    module = AfterstateFeatures(lookahead=[0.0, 0.3])
    here, ahead = module.clearance(before, module.motion(action)).unbind(-1)
    nearest = after[:, 4:].amin(-1)
    close = nearest < 1.5
    assert close.sum() > 30
    assert (here - nearest)[close].abs().max() < 0.2  # a sector is 12° wide
    assert (here - nearest)[close].abs().mean() < 0.03
    faster = module.motion(action + torch.tensor([1.5, 0.0]))  # 0.3 m more on a course without a turn
    further = module.clearance(before, faster)[:, 0]
    straight = action[:, 1].abs() < 0.3
    torch.testing.assert_close(ahead[straight], further[straight], atol=0.02, rtol=0)


def test_clearance_tells_a_turn_that_avoids_a_box_from_one_that_does_not():
    scan = torch.full((1, 30), 4.0)
    scan[0, 15:18] = 0.5  # ahead, and to the left
    observation = torch.cat([torch.tensor([[5.0, 0.0, 4.0, 1.0]]), scan], -1)
    module = AfterstateFeatures(lookahead=[0.5])
    motions = [module.motion(torch.tensor([[0.5, turn]])) for turn in (2.0, -2.0)]
    left, right = (module.clearance(observation, motion) for motion in motions)
    assert right > left + 0.1


def test_its_gradient_in_the_action_is_that_of_finite_differences():
    before, action, _ = driven()
    before, action = before[:5].double(), action[:5].double().requires_grad_()
    features = AfterstateFeatures(lookahead=[0.0, 0.5]).double()
    assert torch.autograd.gradcheck(lambda a: features(before, a), action)


def test_a_critic_sees_what_the_action_leads_to():
    before, action, _ = driven()
    torch.manual_seed(0)
    critic = VectorCritic(3, 2, **SIZES, afterstate=AfterstateFeatures())
    features = [critic.features.out_features, critic.afterstate.out_features]
    assert critic.mlp[0].in_features == sum(features) + 2 + 2
    assert critic.stackable
    arguments = before, torch.zeros(len(before), 2), action
    value = critic(*arguments)
    assert value.shape == (len(before), 3)
    with torch.no_grad():
        critic.mlp[0].weight[:, features[0] : sum(features)] = 0
    assert not torch.allclose(critic(*arguments), value)


def test_the_config_gives_it_the_robot_and_the_view_of_the_run_or_leaves_it_out():
    def critic(*overrides):
        training = make_training(configure(*overrides))
        return training.critic(**live_objects(training.make_env({}, 1)))

    afterstate = critic("env.world.robot.max_turn=2.0", "env.world.step_time=0.1", "env.observe_human=false").afterstate
    assert (afterstate.robot.max_turn, afterstate.step_time, afterstate.features.observe_human) == (2.0, 0.1, False)
    assert critic("critic.afterstate=null").afterstate is None
