"""Parts wired to a trainer: every part that a config names is used, one seed is one result, and resuming is exact."""

import pytest
import torch
from support import assert_identical, configure, learned, trainer_for
from torchrl.checkpoint import CheckpointRotation
from torchrl.data import PrioritizedSampler
from torchrl.modules import AdditiveGaussianModule

from morlnav import data
from morlnav.modules.networks import StackableLinear
from morlnav.navigation.world import DifferentialDrive, PymunkWorld, Scene
from morlnav.objectives import ClampedAngleTerm
from morlnav.trainers.checkpoint import load_checkpoint

BRIEF = (
    "trainer.total_frames=32",
    "collector.init_random_frames=16",
    "hooks.evaluate.interval=16",
    "hooks.fit_interpolator.interval=16",
    "transforms.time_limit.max_steps=20",
)
CLAMPED = "loss.terms.angle={_target_: morlnav.objectives.ClampedAngleTerm, actor: 10.0, critic: 1.0, degrees: true}"


def latest(directory):
    return CheckpointRotation(directory / "checkpoints", keep_last=1).latest()


def train_briefly(directory, *overrides, look=lambda trainer: None):
    """Two batches, the second with optimisation steps; returns the trainer and the losses it reported."""
    trainer = trainer_for(configure(*BRIEF, *overrides), directory)
    look(trainer)  # while its environment is there
    losses = []
    trainer.register_op("post_optim_complete_log", lambda _, values: losses.append(values.clone()))
    trainer.train()
    assert losses
    for name in ("loss_qvalue", "loss_actor", "pred_value", "grad_norm_qvalue"):
        assert losses[-1][name].isfinite().all(), name
    assert all(parameter.isfinite().all() for parameter in trainer.loss_module.parameters())
    return trainer, losses


def test_one_seed_is_one_result(tmp_path):
    first, second, other = (
        train_briefly(tmp_path / name, f"seed={seed}")[0] for name, seed in (("a", 3), ("b", 3), ("c", 4))
    )
    assert_identical(learned(first), learned(second))
    assert not torch.equal(first.replay_buffer.storage[:]["observation"], other.replay_buffer.storage[:]["observation"])


def test_a_compiled_loss_learns_the_same(tmp_path):
    compiled, eager = (
        train_briefly(tmp_path / name, f"compile={value}")[0]
        for name, value in (("compiled", "{backend:eager}"), ("eager", "null"))
    )
    assert hasattr(compiled.loss_module.value_loss, "_torchdynamo_orig_callable")
    assert_identical(learned(compiled), learned(eager))


@pytest.mark.parametrize(
    ("batches", "overrides"),
    [
        (2, []),  # while actions are still random
        (
            11,
            ["transforms.time_limit.max_steps=5"],
        ),  # episodes end and begin anew; the actor's delayed update is pending
        (
            5,
            [
                "world=pymunk",
                "env.num_envs=4",
                "collector.frames_per_batch=8",
                CLAMPED,
                *BRIEF,
                "trainer.total_frames=64",
            ],
        ),
        (4, ["replay.storage.max_size=64"]),  # the buffer is just full
        (
            7,  # and more than full
            ["replay.storage.max_size=64", "replay.transforms.relabel={share: 0.75, num_relabels: 2}"],
        ),
        (7, ["replay=prioritised", "replay.transforms.relabel.num_relabels=2"]),
    ],
    ids=["random", "episodes", "pymunk", "full", "overwriting", "prioritised"],
)
def test_a_resumed_training_equals_an_unbroken_one_bit_for_bit(batches, overrides, tmp_path):
    cfg = configure(
        "trainer.total_frames=256", "stepper.policy_update_delay=3", "trainer.optim_steps_per_batch=1", *overrides
    )
    whole = trainer_for(cfg, tmp_path / "whole")
    whole.train()
    expected = learned(whole)

    stopped = trainer_for(cfg, tmp_path / "stopped")
    left = iter(range(batches - 1, -1, -1))
    stopped.register_op("post_steps", lambda: next(left, 0) or stopped.request_stop("enough"))
    stopped.train()
    assert stopped.collected_frames == batches * cfg.collector.frames_per_batch

    resumed = trainer_for(cfg, tmp_path / "resumed")
    torch.manual_seed(99)
    load_checkpoint(resumed, latest(tmp_path / "stopped"))
    assert resumed.collected_frames == stopped.collected_frames
    reported, remembered = (t.optimization_stepper.state_dict()["actor_metrics"] for t in (stopped, resumed))
    assert reported == remembered
    resumed.train()
    assert_identical(learned(resumed), expected)


# Swapping parts


def world_of(trainer):
    return trainer.collector.env.base_env.world


def samplers_of(trainer):
    """Who draws preferences in the environment, and who in replay."""
    transforms = [*trainer.collector.env.transform, *trainer.replay_buffer.transform]
    return {type(transform.sampler) for transform in transforms if hasattr(transform, "sampler")}


def product_dtypes_of(trainer):
    """In which types the layers of the actor multiply while it learns."""
    return {layer.dtype for layer in trainer.loss_module.actor_network.modules() if isinstance(layer, StackableLinear)}


@pytest.mark.parametrize(
    ("words", "is_used"),
    [
        ("world=pymunk env.num_envs=4", lambda trainer: isinstance(world_of(trainer), PymunkWorld)),
        ("preferences=dirichlet", lambda trainer: samplers_of(trainer) == {data.DirichletPreferences}),
        ("preferences=uniform", lambda trainer: samplers_of(trainer) == {data.UniformPreferences}),
        ("preferences=segments", lambda trainer: samplers_of(trainer) == {data.SegmentedPreferences}),
        ("preferences=grid", lambda trainer: samplers_of(trainer) == {data.GridPreferences}),
        (
            "preferences=fixed preferences.value=[0.5,0.5]",
            lambda trainer: samplers_of(trainer) == {data.FixedPreferences},
        ),
        ("loss.terms.angle=null", lambda trainer: list(trainer.loss_module.terms) == ["proposals"]),
        (CLAMPED, lambda trainer: isinstance(trainer.loss_module.terms["angle"], ClampedAngleTerm)),
        ("loss.terms.angle.interpolator=null", lambda trainer: trainer.loss_module.terms["angle"].interpolator is None),
        ("loss.num_qvalue_nets=3", lambda trainer: trainer.loss_module.qvalue_network_params.batch_size == (3,)),
        ("replay=prioritised", lambda trainer: isinstance(trainer.replay_buffer.sampler, PrioritizedSampler)),
        ("exploration=gaussian", lambda trainer: isinstance(trainer.collector.policy[1], AdditiveGaussianModule)),
        ("env.scenes.num_boxes=0", lambda trainer: world_of(trainer).scene.boxes.shape == (16, 0, 5)),
        ("transforms.returns=null", lambda trainer: "episode_reward" not in trainer.collector.env.reset()),
        ("hooks.log_episodes=null", lambda trainer: "log_episodes" not in trainer._modules),
        ("stepper.schedule=null", lambda trainer: trainer.optimization_stepper.schedulers == {}),
        ("products=bfloat16", lambda trainer: torch.bfloat16 in product_dtypes_of(trainer)),
        ("products=float32", lambda trainer: product_dtypes_of(trainer) == {None, torch.float32}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_part_that_a_word_names_is_used(words, is_used, tmp_path):
    used = []
    train_briefly(
        tmp_path,
        *([words] if words == CLAMPED else words.split()),
        look=lambda trainer: used.append(is_used(trainer)),
    )
    assert used == [True]


def test_without_relabelling_what_was_collected_is_sampled(tmp_path):
    trainer, _ = train_briefly(tmp_path, "replay.transforms.relabel=null")
    rows = {tuple(row) for row in trainer.replay_buffer.storage[:]["preference"].tolist()}
    assert {tuple(row) for row in trainer.replay_buffer.sample()["preference"].tolist()} <= rows


@pytest.mark.parametrize("recipe", ["analytical", "paper"])
def test_a_recipe_is_one_word(recipe, tmp_path):
    words = [
        "trainer=smoke",
        "trainer.total_frames=12",
        "collector.init_random_frames=6",
        "replay.storage.max_size=1000",
    ]
    trainer, _ = train_briefly(tmp_path, f"recipe={recipe}", *(words if recipe == "paper" else []))
    assert isinstance(trainer.loss_module.terms["angle"], ClampedAngleTerm) == (recipe == "paper")


@pytest.mark.parametrize("preferences", ["corners", "dirichlet", "uniform", "segments", "grid", "fixed"])
def test_a_single_objective_has_one_preference(preferences, tmp_path):
    value = ["preferences.value=[1.0]"] * (preferences == "fixed")
    trainer, _ = train_briefly(tmp_path, "objectives=[baseline,distance]", f"preferences={preferences}", *value)
    stored = trainer.replay_buffer.storage[:]
    assert stored["next", "reward"].shape[-1] == 2
    torch.testing.assert_close(stored["preference"], torch.ones(32, 1))


def test_without_static_objectives_every_entry_is_weighed(tmp_path):
    trainer, losses = train_briefly(tmp_path, "objectives=[distance,efficiency]")
    assert trainer.replay_buffer.storage[:]["preference"].shape == (32, 2)
    assert losses[-1]["pred_value"].shape == (2,)


def test_an_objective_of_the_users_own_needs_no_change_in_the_package(tmp_path, monkeypatch):
    (tmp_path / "my_rewards.py").write_text(
        "class Calm:\n"
        "    def __init__(self, penalty):\n"
        "        self.penalty = penalty\n\n"
        "    def __call__(self, transition):\n"
        "        return self.penalty * transition.action[..., 1].abs()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    calm = ["+env.objectives.calm._target_=my_rewards.Calm", "+env.objectives.calm.penalty=-2.0"]
    trainer, losses = train_briefly(tmp_path / "run", *calm)
    stored = trainer.replay_buffer.storage[:]
    assert stored["preference"].shape == (32, 3)
    torch.testing.assert_close(stored["next", "reward"][:, 3], -2 * stored["action"][:, 1].abs())
    assert losses[-1]["pred_value"].shape == (4,)


def test_without_the_human_in_view_the_networks_shrink(tmp_path):
    trainer, _ = train_briefly(tmp_path, "ablation=no_human")
    assert trainer.replay_buffer.storage[:]["observation"].shape == (32, 32)


# Values of the config where they belong


@pytest.mark.parametrize(
    ("override", "gamma"),
    [("ablation=gamma_099", 0.99), ("ablation=gamma_095", 0.95), ("hooks.discount.end=0.98", 0.98)],
)
def test_the_discount_ends_where_the_config_says(override, gamma, tmp_path):
    trainer, _ = train_briefly(tmp_path, override)
    assert trainer.loss_module.value_estimator.gamma.item() == pytest.approx(gamma)


def test_scales_and_tie_breaks_follow_the_objectives_of_the_config(tmp_path):
    trainer, _ = train_briefly(
        tmp_path,
        "loss.scalarisation.scale={default: 1.0, distance: 0.7, efficiency: 1.2}",
        "loss.scalarisation.tie_break={default: 0.0, efficiency: 0.2}",
    )
    loss = trainer.loss_module
    torch.testing.assert_close(loss.scalarisation.scale, torch.tensor([0.7, 1.2]))
    torch.testing.assert_close(loss.scalarisation.tie_break, torch.tensor([0.0, 0.2]))


def worlds_of(trainer):
    """Where it learns, and where it is measured."""
    return world_of(trainer), trainer._modules["evaluate"].evaluation.env.world


@pytest.mark.parametrize("world", ["tensor", "pymunk"])
def test_a_robot_grazes_a_box_while_it_learns_and_passes_it_when_evaluated(world, tmp_path):
    trainer = trainer_for(configure(f"world={world}", "env.inflation=0.04"), tmp_path)
    box = torch.tensor([[[1.0, 0.7, 0.5, 0.5, 0.0]]])  # its side is 0.2 m from the way
    scene = Scene(torch.zeros(1, 3), torch.tensor([[9.0, 0.0]]), torch.tensor([[5.0, 2.0]]), box, batch_size=[1])
    touched = []
    for robots in worlds_of(trainer):
        robots.reset(scene)
        contacts = [robots.step(torch.tensor([[0.5, 0.0]])).box for _ in range(20)]
        touched.append(bool(torch.stack(contacts).any()))
    assert touched == [True, False]


class Crawler:
    """A robot of another kind, which is no dataclass."""

    def __init__(self, radius, max_speed, max_turn):
        self.radius, self.max_speed, self.max_turn = radius, max_speed, max_turn

    action_low, action_high = DifferentialDrive.action_low, DifferentialDrive.action_high
    limit, move = DifferentialDrive.limit, DifferentialDrive.move


def test_a_robot_of_another_kind_is_wider_while_it_learns(tmp_path):
    cfg = configure(f"env.world.robot._target_={__name__}.Crawler", "env.inflation=0.04")
    worlds = worlds_of(trainer_for(cfg, tmp_path))
    assert all(isinstance(world.robot, Crawler) for world in worlds)
    assert [world.robot.radius for world in worlds] == pytest.approx([0.22, 0.18])


def test_learning_rates_fall_to_their_end_with_the_last_update(tmp_path):
    cfg = configure("trainer.total_frames=128", "collector.init_random_frames=0", "stepper.schedule.end=0.1")
    trainer = trainer_for(cfg, tmp_path)
    trainer.train()
    rates = {
        name: optimizer.param_groups[0]["lr"] for name, optimizer in trainer.optimization_stepper.optimizers.items()
    }
    began = {"actor": cfg.stepper.optimizer_actor.lr, "critic": cfg.stepper.optimizer_critic.lr}
    assert rates == pytest.approx({name: 0.1 * rate for name, rate in began.items()})


def test_stored_rewards_are_raw_and_the_learners_are_scaled(tmp_path):
    trainer, _ = train_briefly(tmp_path, "replay.transforms.scale.scale=0.5")
    assert (trainer.replay_buffer.storage[:]["next", "reward"][:, 2] == -10).all()
    assert (trainer.replay_buffer.sample()["next", "reward"][:, 2] == -5).all()


def test_an_angle_of_the_tuneable_entries_needs_one_word(tmp_path):
    trainer = trainer_for(
        configure("loss.terms.angle.tuneable_only=true", "loss.terms.angle.interpolator.steps=2"), tmp_path
    )
    term = trainer.loss_module.terms["angle"]
    trainer.collector.shutdown()
    assert term.interpolator.num_static == 0
    assert term.interpolator.preferences.tolist() == [[0, 1], [0.5, 0.5], [1, 0]]
