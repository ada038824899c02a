from types import SimpleNamespace

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import Compose, StepCounter, TransformedEnv

from morlnav.data import UniformPreferences
from morlnav.modules import Actor, PreferenceInterpolator, VectorCritic
from morlnav.navigation.envs import NavigationEnv
from morlnav.objectives import MORLTD3Loss
from morlnav.trainers import FitInterpolator
from morlnav.transforms import DrawPreference

BOUNDS = {"action_low": [0.0, -torch.pi], "action_high": [0.5, torch.pi]}


def make_env():
    base = NavigationEnv(num_envs=6, seed=0)
    return TransformedEnv(base, Compose(StepCounter(30), DrawPreference(UniformPreferences(2))))


def make_trainer(interpolator):
    torch.manual_seed(0)
    actor = TensorDictModule(Actor(2, depth=1, **BOUNDS), ["observation", "preference"], ["action"])
    critic = TensorDictModule(
        VectorCritic(3, 2, depth=1, **BOUNDS), ["observation", "preference", "action"], ["state_action_value"]
    )
    spec = NavigationEnv().action_spec
    loss = MORLTD3Loss(actor, critic, action_spec=spec, terms={"angle": AngleTerm(interpolator=interpolator)})
    loss.make_value_estimator(gamma=0.9)
    with torch.no_grad():  # drives forward at 0.35 m/s, so that episodes end in contact or at their time limit
        loss.actor_network_params["module", "mlp", "2", "bias"].copy_(torch.tensor([0.4, 0.0]))
    logged = {}
    return SimpleNamespace(
        loss_module=loss,
        collected_frames=100,
        logged=logged,
        _log=logged.update,
        register_op=lambda *_: None,
        register_module=lambda *_: None,
    )


@pytest.mark.parametrize("key", [[1.0, 0.0], [0.3, 0.7]])
def test_a_key_gets_the_mean_discounted_return_of_its_episodes(key):
    trainer = make_trainer(PreferenceInterpolator(2, preferences=[key]))
    hook = FitInterpolator(make_env(), frames=100, max_steps=50)
    hook.register(trainer)
    hook()

    loss, env = trainer.loss_module, make_env()
    td = env.reset()  # in the same scenes
    td["preference"] = torch.tensor(key).expand(6, 2)
    running, total, plain = torch.ones(6, 1), torch.zeros(6, 3), torch.zeros(6, 3)
    for step in range(30):
        with torch.no_grad(), loss.actor_network_params.to_module(loss.actor_network):
            td = env.step(loss.actor_network(td))["next"]
        total += running * 0.9**step * td["reward"]
        plain += running * td["reward"]
        running = running * ~td["done"]
    torch.testing.assert_close(loss.interpolator.values, total.mean(0, keepdim=True))
    assert loss.interpolator.ready
    utility = (torch.tensor([1.0, *key]) * plain.mean(0)).sum().item()
    assert trainer.logged["expected_utility"] == pytest.approx(utility, rel=1e-5)


def test_it_waits_until_enough_frames_have_passed():
    trainer = make_trainer(PreferenceInterpolator(2, steps=1))
    hook = FitInterpolator(make_env(), frames=101, max_steps=50)
    hook.register(trainer)
    hook()
    assert not trainer.loss_module.terms["angle"].interpolator.ready


def test_a_loss_without_an_interpolator_is_refused_in_one_sentence():
    with pytest.raises(ValueError, match="needs a loss with an interpolator"):
        FitInterpolator(make_env(), frames=1, max_steps=50).register(make_trainer(None))
