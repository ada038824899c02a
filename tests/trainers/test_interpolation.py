from types import SimpleNamespace

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import Compose, StepCounter, TransformedEnv

from morlnav.data import UniformPreferences
from morlnav.deployment import save
from morlnav.evaluation import Evaluation
from morlnav.evaluation.evaluator import HELD_OUT
from morlnav.modules import Actor, PreferenceInterpolator, VectorCritic
from morlnav.navigation.envs import NavigationEnv
from morlnav.objectives import AngleTerm, MORLTD3Loss
from morlnav.trainers import FitInterpolator
from morlnav.transforms import DrawPreference

ROBOT = {"action_low": [0.0, -torch.pi], "action_high": [0.5, torch.pi], "features": 34}


def make_env(num_envs):
    base = NavigationEnv(num_envs=num_envs, seed=0)
    return TransformedEnv(base, Compose(StepCounter(30), DrawPreference(UniformPreferences(2))))


def make_evaluation():
    base = NavigationEnv()
    return Evaluation(
        seed=7,
        make_env=make_env,
        rewards=tuple(base.rewards),
        num_objectives=2,
        reward_bounds=base.reward_bounds,
        max_steps=50,
    )


def make_trainer(interpolator):
    torch.manual_seed(0)
    actor = TensorDictModule(Actor(2, depth=1, **ROBOT), ["observation", "preference"], ["action"])
    critic = TensorDictModule(
        VectorCritic(3, 2, depth=1, **ROBOT), ["observation", "preference", "action"], ["state_action_value"]
    )
    spec = NavigationEnv().action_spec
    loss = MORLTD3Loss(actor, critic, action_spec=spec, terms={"angle": AngleTerm(interpolator=interpolator)})
    loss.make_value_estimator(gamma=0.9)
    with torch.no_grad():  # drives forward at 0.35 m/s, so that episodes end in contact or at their time limit
        loss.actor_network_params["module", "mlp", "2", "bias"].copy_(torch.tensor([0.4, 0.0]))
    logged = {}
    return SimpleNamespace(
        loss_module=loss,
        policy=actor.module,
        collected_frames=100,
        logged=logged,
        logger=SimpleNamespace(log_scalar=lambda name, value, step: logged.update({name: (value, step)})),
        register_op=lambda *_: None,
        register_module=lambda *_: None,
    )


def make_hook(trainer, interval, keys=None):
    settings = {"evaluation": make_evaluation(), "policy": trainer.policy, "objectives": ("distance", "efficiency")}
    settings["size"] = 34
    hook = FitInterpolator(interval, 6, keys, **settings)
    hook.register(trainer)
    return hook


@pytest.mark.parametrize("key", [[1.0, 0.0], [0.3, 0.7]])
def test_a_key_gets_the_mean_discounted_return_of_its_episodes(key):
    trainer = make_trainer(PreferenceInterpolator(2, preferences=[key]))
    make_hook(trainer, interval=100)()

    loss, env = trainer.loss_module, make_env(6)
    env.set_seed(HELD_OUT + 7 + 1)
    td = env.reset()  # in the same scenes
    td["preference"] = torch.tensor(key).expand(6, 2)
    running, total = torch.ones(6, 1), torch.zeros(6, 3)
    for step in range(30):
        with torch.no_grad(), loss.actor_network_params.to_module(loss.actor_network):
            td = env.step(loss.actor_network(td))["next"]
        total += running * 0.9**step * td["reward"]
        running = running * ~td["done"]
    interpolator = loss.terms["angle"].interpolator
    torch.testing.assert_close(interpolator.values, total.mean(0, keepdim=True))
    assert interpolator.ready
    utility = (torch.tensor([1.0, *key]) * total.mean(0)).sum().item()
    assert trainer.logged == {"optim/key_utility": (pytest.approx(utility, rel=1e-5), 100)}


def test_it_waits_until_enough_frames_have_passed():
    trainer = make_trainer(PreferenceInterpolator(2, steps=1))
    make_hook(trainer, interval=101)()
    assert not trainer.loss_module.terms["angle"].interpolator.ready


def save_driver(directory, objectives=("distance", "efficiency"), features=34):
    """A policy that stands still, in a run directory."""
    actor = Actor(2, depth=1, **ROBOT | {"features": features})
    torch.nn.init.zeros_(actor.mlp[-1].weight)
    actor.mlp[-1].bias.data = torch.tensor([-20.0, 0.0])  # v = 0
    save(actor, objectives, directory)


def test_each_key_keeps_the_best_value_of_two_policies(tmp_path):
    save_driver(tmp_path)
    keys = [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]
    trainer = make_trainer(PreferenceInterpolator(2, preferences=keys))
    interpolator = trainer.loss_module.terms["angle"].interpolator
    hook = make_hook(trainer, interval=50, keys=str(tmp_path))
    hook()  # long before it is due
    evaluation, weights = make_evaluation(), torch.tensor([[1.0, *key] for key in keys])
    standing, driving = (
        evaluation.returns(policy, torch.tensor(keys), 6, 8, 0.9).mean(1)
        for policy in (hook.policies[1], trainer.policy)
    )
    assert (standing[:, 0].abs() < 1e-3).all()  # who stands still neither comes nearer nor collides
    both = torch.cat([driving, standing])
    torch.testing.assert_close(interpolator.values, both[(weights @ both.mT).argmax(-1)])
    assert not torch.equal(interpolator.values, driving)
    assert trainer.logged["optim/key_utility"] == (
        pytest.approx((weights * driving).sum(-1).mean().item(), rel=1e-4),
        100,
    )

    trainer.logged.clear()
    for frames, due in ((149, False), (150, True)):
        trainer.collected_frames = frames
        hook()
        assert bool(trainer.logged) is due
    resumed = make_hook(make_trainer(PreferenceInterpolator(2, steps=1)), interval=50, keys=str(tmp_path))
    resumed.load_state_dict(hook.state_dict())
    resumed.trainer.collected_frames = 199
    resumed()
    assert resumed.trainer.logged == {}


def test_keys_of_other_objectives_are_refused(tmp_path):
    save_driver(tmp_path, ("efficiency", "distance"))
    with pytest.raises(ValueError, match="weighs efficiency, distance, not distance, efficiency"):
        make_hook(make_trainer(PreferenceInterpolator(2, steps=1)), interval=1, keys=str(tmp_path))


def test_a_policy_of_keys_that_sees_other_things_is_refused(tmp_path):
    save_driver(tmp_path, features=32)
    with pytest.raises(ValueError, match="cannot drive here"):
        make_hook(make_trainer(PreferenceInterpolator(2, steps=1)), interval=1, keys=str(tmp_path))


class Calm(Actor):
    """An actor of one's own."""


def test_a_policy_of_ones_own_class_is_trusted_where_it_learns_too(tmp_path):
    save(Calm(2, depth=1, **ROBOT), ("distance", "efficiency"), tmp_path)
    trainer = make_trainer(PreferenceInterpolator(2, steps=1))
    with pytest.raises(ValueError, match="names the foreign class"):
        make_hook(trainer, interval=1, keys=str(tmp_path))
    trainer.policy = Calm(2, depth=1, **ROBOT)
    assert isinstance(make_hook(trainer, interval=1, keys=str(tmp_path)).policies[1], Calm)


def test_keys_that_serve_nothing_are_refused(tmp_path):
    save_driver(tmp_path)
    with pytest.raises(ValueError, match="has keys, and no term of the loss an interpolator"):
        make_hook(make_trainer(None), interval=1, keys=str(tmp_path))


def test_a_loss_without_an_interpolator_costs_no_roll_out():
    trainer = make_trainer(None)
    hook = make_hook(trainer, interval=1)
    hook.evaluation = None  # nobody could be asked
    hook()
    assert trainer.logged == {}


def test_no_episodes_are_refused():
    with pytest.raises(ValueError, match="episodes must be at least 1, got 0"):
        FitInterpolator(episodes=0, evaluation=make_evaluation(), policy=torch.nn.Identity())
