"""Every roll-out drives in evaluation mode, while training goes on in training mode."""

from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import Compose, StepCounter, TransformedEnv

from morlnav.data import UniformPreferences, roll_out_ranked
from morlnav.evaluation import Evaluation
from morlnav.modules import EpsilonGreedyNoise, PreferenceInterpolator, VectorCritic
from morlnav.modules.mode import eval_mode
from morlnav.navigation.demonstrations import record_demonstrations
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.evaluation import evaluate_policy, evaluation_scenes
from morlnav.navigation.world import SceneSampler
from morlnav.objectives import AngleTerm, BehaviourCloningLoss, MORLTD3Loss
from morlnav.trainers import Fit, FitInterpolator
from morlnav.transforms import DrawPreference

LOW, HIGH = torch.tensor([0.0, -torch.pi]), torch.tensor([0.5, torch.pi])
LAYERS = {"dropout": lambda: nn.Dropout(0.5), "batch norm": lambda: nn.BatchNorm1d(8)}


class Driver(nn.Module):
    """Drives to the goal, more or less: a part of its turn goes through the layer."""

    def __init__(self, layer):
        super().__init__()
        self.layer, self.features, self.turn = layer, nn.Linear(34, 8), nn.Linear(8, 1)
        self.frozen = nn.Dropout().eval()

    def forward(self, observation, preference=None):
        turn = 2 * observation[..., 1:2] + 0.1 * self.turn(self.layer(self.features(observation))).tanh()
        return torch.cat([0.4 + 0 * turn, turn.clamp(-3, 3)], -1)


@pytest.fixture(params=LAYERS)
def driver(request):
    torch.manual_seed(0)
    driver = Driver(LAYERS[request.param]())
    driver(torch.rand(64, 34))  # statistics
    yield driver
    assert driver.training
    assert driver.layer.training
    assert not driver.frozen.training


@pytest.fixture
def twin(driver):
    """The same driver in evaluation mode for good."""
    twin = Driver(type(driver.layer)(8 if isinstance(driver.layer, nn.BatchNorm1d) else 0.5))
    twin.load_state_dict(driver.state_dict())
    return twin.eval()


def test_an_evaluation(driver, twin):
    before = {name: value.clone() for name, value in driver.state_dict().items()}
    first, second = (
        evaluate_policy(policy, evaluation_scenes(3), torch.eye(2), max_steps=60) for policy in (driver, twin)
    )
    assert torch.equal(first.pose, second.pose)
    assert all(torch.equal(value, before[name]) for name, value in driver.state_dict().items())


def test_ranked_rollouts(driver, twin):
    def ranked(policy):
        torch.manual_seed(3)
        make_noise = lambda levels: EpsilonGreedyNoise(levels, LOW, HIGH)  # noqa: E731
        make_env = lambda count: NavigationEnv(num_envs=count, seed=0)  # noqa: E731
        return roll_out_ranked(policy, make_env, make_noise, [0.0, 0.5], episodes=2, max_steps=10)

    assert torch.equal(ranked(driver)["action"], ranked(twin)["action"])


def test_demonstrations(driver, twin):
    scenes = SceneSampler(distance=(3.0, 4.0), num_boxes=0, human_clearance=0.1)
    scenes_without_human = lambda *args, **settings: aside(scenes(*args, **settings))  # noqa: E731
    first, second = (record_demonstrations(policy, scenes_without_human, 3, num_envs=4)[0] for policy in (driver, twin))
    assert torch.equal(first["action"], second["action"])


def aside(scene):
    scene.human[:] = torch.tensor([0.0, 9.0])
    return scene


def test_values_of_the_interpolators_keys(driver, twin):
    def make_env(num_envs):
        env = NavigationEnv(num_envs=num_envs, seed=0)
        return TransformedEnv(env, Compose(StepCounter(10), DrawPreference(UniformPreferences(2))))

    bare = NavigationEnv()
    spaces = {"rewards": tuple(bare.rewards), "num_objectives": 2, "reward_bounds": bare.reward_bounds}
    evaluation = Evaluation(make_env=make_env, max_steps=10, **spaces)

    def values(policy):
        actor = TensorDictModule(policy, ["observation", "preference"], ["action"])
        critic = VectorCritic(3, 2, LOW, HIGH, features=34, depth=1)
        critic = TensorDictModule(critic, ["observation", "preference", "action"], ["state_action_value"])
        interpolator = PreferenceInterpolator(2, steps=1)
        loss = MORLTD3Loss(actor, critic, bounds=(LOW, HIGH), terms={"angle": AngleTerm(interpolator=interpolator)})
        loss.make_value_estimator(gamma=0.9)
        hook = FitInterpolator(100, episodes=4, evaluation=evaluation, policy=policy)
        trainer = {"loss_module": loss, "collected_frames": 100, "logger": None}
        nothing = {"register_op": lambda *_: None, "register_module": lambda *_: None}
        hook.register(SimpleNamespace(**trainer, **nothing))
        hook()
        assert interpolator.ready
        return interpolator.values

    assert torch.equal(values(driver), values(twin))


def test_a_held_out_loss(driver):
    seen = []
    driver.layer.register_forward_hook(lambda layer, inputs, _: seen.append((len(inputs[0]), layer.training)))
    rows = TensorDict(observation=torch.rand(20, 34), action=torch.rand(20, 2), batch_size=[20])
    loss = BehaviourCloningLoss(TensorDictModule(driver, ["observation"], ["action"]), bounds=(LOW, HIGH))
    Fit(steps=2, interval=1)(loss, lambda: rows[:16], rows[16:])
    assert set(seen) == {(16, True), (4, False)}


def test_an_error_leaves_no_trace(driver):
    with pytest.raises(KeyError), eval_mode(driver):
        raise KeyError


def test_any_callable_may_drive():
    with eval_mode(lambda observation: observation):
        pass
