"""Every part works on an accelerator: fake tensors on "cuda:0" raise where two devices meet, on any machine.

They have a shape and a device but no values, so whatever waits for one raises, too. Where a part may ask, as TorchRL's
``reset`` does, :func:`answers` gives some value.
"""

from contextlib import contextmanager

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch._subclasses import FakeTensorMode
from torch._subclasses.fake_tensor import DataDependentOutputException
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.envs import Compose, RewardSum, StepCounter, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import SoftUpdate, ValueEstimators

from morlnav.data import (
    CornerWeightedPreferences,
    DirichletPreferences,
    FixedPreferences,
    GridPreferences,
    SegmentedPreferences,
    UniformPreferences,
    roll_out_ranked,
)
from morlnav.modules import (
    Actor,
    EpsilonGreedyNoise,
    NormalisedReward,
    PartlyGreedyNoise,
    PreferenceInterpolator,
    RewardEnsemble,
    RewardModel,
    VectorCritic,
    round_products,
)
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.modules import AfterstateFeatures, CircumnavigationOracle, NavigationFeatures, WanderingNoise
from morlnav.navigation.world import Scene, SceneSampler, TensorWorld
from morlnav.objectives import (
    AngleTerm,
    ClampedAngleTerm,
    Guidance,
    LinearScalarisation,
    MORLTD3Loss,
    Proposals,
    Search,
)
from morlnav.trainers import PathwiseRefinement, refinement
from morlnav.transforms import DemonstrationReward, DrawPreference, HindsightPreferenceRelabel

DEVICE = torch.device("cuda:0")
ROBOT = {"action_low": [0.0, -torch.pi], "action_high": [0.5, torch.pi]}
SAMPLERS = [
    CornerWeightedPreferences(2),
    DirichletPreferences(2, [0.5, 1.0]),
    FixedPreferences([0.25, 0.75]),
    GridPreferences(2, steps=4),
    SegmentedPreferences(2, segments=3),
    UniformPreferences(2),
]

pytestmark = pytest.mark.skipif(torch.version.cuda is None, reason="PyTorch knows no CUDA device here")


def _apply(module, move, recurse=True):
    """As ``Module.to`` moves tensors, but by new ones: PyTorch's own way puts no fake one in a real one's place."""
    for child in module.children():
        child._apply(move)
    with torch.no_grad():
        for name, parameter in module._parameters.items():
            moved = move(parameter)
            if moved is not parameter:
                module._parameters[name] = nn.Parameter(moved, parameter.requires_grad)
        for name, buffer in module._buffers.items():
            module._buffers[name] = move(buffer)
    return module


@pytest.fixture
def accelerator(monkeypatch):
    """Within ``with accelerator``, "cuda:0" is there and tensors are fake; what they are built from may be real."""
    monkeypatch.setattr(nn.Module, "_apply", _apply)
    # TorchRL compares the bounds of a batch, and draws seeds; scenes are checked on the CPU, where they are drawn.
    monkeypatch.setattr(torch, "allclose", lambda *_, **__: True)
    monkeypatch.setattr(torch.Tensor, "random_", lambda tensor, *_, **__: tensor)
    monkeypatch.setattr(Scene, "check", lambda *_: None)
    monkeypatch.setattr("morlnav.objectives.bounds.check_bounds", lambda *_: None)  # at the start, where it may wait
    monkeypatch.setattr(torch, "_sample_dirichlet", lambda chances, **_: torch.rand_like(chances))  # knows no fakes
    return FakeTensorMode(allow_non_fake_inputs=True)


@contextmanager
def answers():
    """Values for whoever asks, such as checks and TorchRL's ``reset``: nothing is wrong, and no episode has ended."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch.Tensor, "__bool__", lambda _: False)
        patch.setattr(torch.Tensor, "__int__", lambda _: 1)
        patch.setattr(torch.Tensor, "item", lambda _: 1)
        patch.setattr(torch.Tensor, "is_set_to", lambda *_: False)
        yield


def make_env(num_boxes=3, num_envs=4, **settings):
    scenes = lambda count, **_: Scene(  # noqa: E731
        start=torch.zeros(count, 3),
        goal=torch.zeros(count, 2),
        human=torch.zeros(count, 2),
        boxes=torch.zeros(count, num_boxes, 5),
        batch_size=[count],
    )
    return NavigationEnv(TensorWorld(device=DEVICE), scenes, num_envs=num_envs, seed=0, **settings)


def make_actor(num_objectives):
    return Actor(num_objectives, **ROBOT, features=NavigationFeatures())


def make_reward():
    return RewardModel(["observation", "action"], **ROBOT, features=NavigationFeatures(octaves=2))


def devices_of(tensordict):
    return {value.device for value in tensordict.values(True, True)}


def transitions():
    def seen():
        return {"observation": torch.rand(8, 34, device=DEVICE), "preference": torch.rand(8, 2, device=DEVICE)}

    flag = torch.zeros(8, 1, dtype=torch.bool, device=DEVICE)
    following = {**seen(), "reward": torch.rand(8, 3, device=DEVICE), "done": flag, "terminated": flag}
    rows = {**seen(), "action": torch.rand(8, 2, device=DEVICE), "next": following}
    return TensorDict(rows, batch_size=[8], device=DEVICE)


# The environment


def test_two_devices_that_meet_raise(accelerator):
    with accelerator, pytest.raises(RuntimeError, match="same device, but found at least two devices"):
        torch.zeros(2, device=DEVICE) + torch.zeros(2)
    with accelerator, pytest.raises(DataDependentOutputException):
        bool(torch.zeros(2, device=DEVICE).any())


@pytest.mark.parametrize("observe_human", [True, False])
def test_the_specs_are_on_the_environments_device(accelerator, observe_human):
    with accelerator:
        env = make_env(observe_human=observe_human)
        for spec in (env.full_observation_spec, env.full_action_spec, env.full_reward_spec, env.full_done_spec):
            assert devices_of(spec) == devices_of(spec.zero()) == {DEVICE}


def test_an_environment_with_all_transforms_begins_and_goes_on(accelerator):
    models = make_reward(), RewardEnsemble([make_reward(), make_reward()]), NormalisedReward(make_reward())
    with accelerator, answers():
        models = [model.to(DEVICE) for model in models]
        env = TransformedEnv(
            make_env(),
            Compose(
                StepCounter(5),
                *(DemonstrationReward(model) for model in models),
                RewardSum(),
                DrawPreference(UniformPreferences(5)),
            ),
        )
        td, following = env.step_and_maybe_reset(env.rand_action(env.reset()))
        again = env.reset(following.set("_reset", torch.ones(4, 1, dtype=torch.bool, device=DEVICE)))
        assert devices_of(td) == devices_of(again) == {DEVICE}
        assert td["next", "episode_reward"].shape == (4, 6)


@pytest.mark.parametrize("num_boxes", [0, 3])
def test_a_step_never_waits_for_the_device(accelerator, num_boxes):
    with accelerator:
        env = make_env(num_boxes=num_boxes)
        following = env._step(env._reset().set("action", torch.zeros(4, 2, device=DEVICE)))
        assert devices_of(following) == {DEVICE}
        assert following["observation"].shape == (4, 34)
        assert following["reward"].shape == (4, 3)


@pytest.mark.parametrize("sampler", SAMPLERS, ids=lambda sampler: type(sampler).__name__)
def test_preferences_are_drawn_where_they_are_wanted(accelerator, sampler):
    with accelerator:
        assert sampler(5, device=DEVICE).device == DEVICE


def test_scenes_go_where_they_are_wanted(accelerator):
    with accelerator, answers():
        assert devices_of(SceneSampler()(5, device=DEVICE).to_tensordict()) == {DEVICE}


# Learning


@pytest.mark.parametrize("kind", [AngleTerm, ClampedAngleTerm])
@pytest.mark.parametrize("dtype", [None, torch.bfloat16], ids=["exact", "rounded"])
def test_an_update_never_waits_for_the_device(accelerator, kind, dtype):
    actor, clone = make_actor(2), make_actor(0)
    seen = {"features": NavigationFeatures(), "afterstate": AfterstateFeatures(lookahead=[0.5])}
    critics = [VectorCritic(3, 2, **ROBOT, **seen) for _ in range(2)]
    scalarisation = LinearScalarisation([1.0, 0.5], [0.0, 0.1])
    angle = kind(critic=1.0, degrees=True, interpolator=PreferenceInterpolator(2, steps=2))
    for network in (actor, clone, *critics):
        round_products(network, dtype)
    with accelerator, answers():
        actor, clone, *critics = (network.to(DEVICE) for network in (actor, clone, *critics))
        clones = {"slow": TensorDictModule(clone, ["observation"], ["action"])}
        proposals = Proposals(Search(proposals=4), Guidance(), clones, objectives=["slow", "far"])
        loss = MORLTD3Loss(
            TensorDictModule(actor, ["observation", "preference"], ["action"]),
            [TensorDictModule(net, ["observation", "preference", "action"], ["state_action_value"]) for net in critics],
            action_spec=make_env().action_spec,
            scalarisation=scalarisation.to(DEVICE),
            terms={"proposals": proposals.to(DEVICE), "angle": angle.to(DEVICE)},
        )
        loss.make_value_estimator(ValueEstimators.TD0, gamma=[0.9, 0.99, 0.99])
        relabel = HindsightPreferenceRelabel(UniformPreferences(2), share=0.75, num_relabels=2)
        parameters = [parameter for parameter in loss.parameters() if parameter.requires_grad]
        optimizer, targets = torch.optim.Adam(parameters, capturable=True), SoftUpdate(loss, tau=0.05)
    with accelerator:
        batch = relabel(transitions()).flatten()
        for losses in (loss.value_loss, loss.actor_loss):
            value, metadata = losses(batch)
            assert {entry.device for entry in (value, *metadata.values())} == {DEVICE}
        for parameter in parameters:  # autograd wants a real device
            parameter.grad = torch.rand_like(parameter)
        torch.nn.utils.clip_grad_norm_(parameters, 10.0)
        optimizer.step()
        targets.step()


def test_a_refinement_stays_on_the_device(accelerator, monkeypatch):
    def prefer(num_envs):
        return TransformedEnv(make_env(num_envs=num_envs), DrawPreference(UniformPreferences(2)))

    actor = make_actor(2)
    with accelerator, answers():
        actor.to(DEVICE)
        monkeypatch.setattr(refinement, "_check", lambda env: None)  # autograd wants a real device
        monkeypatch.setattr(torch.autograd, "grad", lambda value, pushes: [torch.rand_like(push) for push in pushes])
        stage = PathwiseRefinement(
            num_envs=3, make_env=prefer, scalarisation=LinearScalarisation().to(DEVICE), horizon=2
        )
        found = stage._drive(actor, torch.ones(3, device=DEVICE))[:3]
    assert {entry.device for entry in found} == {DEVICE}


def test_the_interpolator_learns_and_answers_without_waiting(accelerator):
    interpolator = PreferenceInterpolator(2, steps=2, decay=0.9)
    with accelerator:
        interpolator.to(DEVICE)
        keys = interpolator.preferences
        assert interpolator.update(keys, torch.rand(3, 3, device=DEVICE)).device == DEVICE
        assert interpolator.update(keys.cpu(), torch.rand(3, 3)).device == DEVICE  # as measured on the host
        assert interpolator(torch.rand(5, 2, device=DEVICE)).device == DEVICE


def test_an_averaged_actor_follows(accelerator):
    actor = make_actor(2)
    with accelerator, answers():
        average = AveragedModel(actor.to(DEVICE), multi_avg_fn=get_ema_multi_avg_fn(0.999))
        average.update_parameters(actor)
        assert {parameter.device for parameter in average.parameters()} == {DEVICE}


# Driving


def test_exploration_noise_stays_on_the_device(accelerator):
    with accelerator, answers():
        noise = PartlyGreedyNoise(0.5, make_env().action_spec_unbatched, std=[0.25, 3.0]).to(DEVICE)
        noise.step(1)
        row = TensorDict(action=torch.rand(4, 2, device=DEVICE), batch_size=[4], device=DEVICE)
        with set_exploration_type(ExplorationType.RANDOM):
            assert noise(row)["action"].device == DEVICE


@pytest.mark.parametrize("kind", [EpsilonGreedyNoise, WanderingNoise])
def test_noise_that_ranks_stays_on_the_device(accelerator, kind):
    noise = kind(torch.tensor([0.0, 0.3, 0.6, 0.9]), **ROBOT, hold=10)
    action, observation = torch.rand(4, 2), torch.rand(4, 34)
    with accelerator:
        noise.to(DEVICE)
        action, observation = action.to(DEVICE), observation.to(DEVICE)
        noise(action, None, observation)
        began = torch.zeros(4, 1, dtype=torch.bool, device=DEVICE)
        assert noise(action, began, observation).device == noise.is_noisy.device == DEVICE


def test_ranked_rollouts_stay_on_the_device(accelerator):
    noise = EpsilonGreedyNoise(torch.tensor([0.0, 0.0, 0.5, 0.5]), **ROBOT)
    with accelerator, answers():
        noise.to(DEVICE)
        oracle = CircumnavigationOracle()
        rollouts = roll_out_ranked(oracle, lambda _: make_env(), lambda _: noise, [0.0, 0.5], episodes=2, max_steps=3)
        assert devices_of(rollouts) == {DEVICE}
