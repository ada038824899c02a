"""TorchRL's stock TD3Trainer, built and run from the example's config."""

import runpy
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from torchrl.trainers.algorithms import TD3Trainer

from morlnav import HindsightPreferenceRelabel, MORLTD3Loss, NavigationEnv

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = [
    "frames=160",
    "env.base_env.num_envs=4",
    "time_limit.max_steps=20",
    "actor.module.num_cells=16",
    "critic.module.num_cells=16",
    "replay.batch_size=32",
    "replay.storage.max_size=1000",
    "loss.terms.angle.interpolator.steps=2",
    "fit_interpolator.frames=100",
    "log_episodes.frames=60",
    "trainer.log_interval=60",
    "trainer.progress_bar=false",
]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A trainer that has trained, the loss's weights and the environment that it began with, and its logs."""
    logs = tmp_path_factory.mktemp("logs")
    main = runpy.run_path(str(EXAMPLES / "torchrl_trainer.py"))["main"].__wrapped__
    with initialize_config_dir(str(EXAMPLES), version_base=None):
        cfg = compose("torchrl_trainer", overrides=[*SMALL, f"logger.log_dir={logs}"])
    before, train = {}, TD3Trainer.train

    def remember(trainer):
        before.update({key: value.clone() for key, value in trainer.loss_module.state_dict().items()})
        before["env"] = trainer.collector.env.base_env
        train(trainer)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TD3Trainer, "train", remember)
        trainer = main(cfg)
    return trainer, before, logs / "torchrl_trainer" / "scalars"


def _read(csv):
    return [tuple(map(float, line.split(","))) for line in csv.read_text().splitlines()]


def test_the_trainer_is_torchrls_and_the_parts_are_ours(run):
    trainer, before, _ = run
    assert type(trainer) is TD3Trainer
    assert isinstance(trainer.loss_module, MORLTD3Loss)
    assert isinstance(before["env"], NavigationEnv)
    assert isinstance(trainer.replay_buffer.transform[0], HindsightPreferenceRelabel)


def test_actor_critics_and_targets_have_moved(run):
    trainer, before, _ = run
    for name, value in trainer.loss_module.state_dict().items():
        if name.endswith("weight"):
            assert not torch.equal(value, before[name]), name


def test_the_twin_critics_start_from_weights_of_their_own_of_ordinary_size(run):
    _, before, _ = run
    weight = before["qvalue_network_params.module.mlp.2.weight"]
    assert not torch.equal(weight[0], weight[1])
    torch.testing.assert_close(weight[0] @ weight[0].T, 2 * torch.eye(16))


def test_the_collector_drives_with_the_learned_weights(run):
    trainer, _, _ = run
    learned = trainer.loss_module.actor_network_params["module", "mlp", "0", "weight"]
    assert torch.equal(trainer.collector.policy[0].module.mlp[0].weight, learned)


def test_replay_draws_fresh_preferences_and_keeps_reward_vectors(run):
    trainer, _, _ = run
    stored = trainer.replay_buffer.storage[:]
    assert stored["next", "reward"].shape == (160, 3)
    drawn = trainer.replay_buffer.sample(100)
    assert not torch.isin(drawn["preference"][:, 0], stored["preference"][:, 0]).any(-1).all()
    assert torch.equal(drawn["preference"], drawn["next", "preference"])


def test_the_interpolator_was_fitted_and_the_episodes_were_logged(run):
    trainer, _, scalars = run
    assert trainer.loss_module.terms["angle"].interpolator.ready
    (step, utility), *_ = _read(scalars / "expected_utility.csv")
    assert step == 100
    assert utility != 0
    (_, length), *_ = _read(scalars / "train" / "episode_length.csv")
    (_, efficiency), *_ = _read(scalars / "train" / "return_efficiency.csv")
    assert 0 < length <= 20
    assert efficiency == pytest.approx(-10 * length)  # raw, although the learner's rewards are scaled


def test_the_discount_of_the_config_reaches_the_loss(run):
    assert run[0].loss_module.value_estimator.gamma.item() == pytest.approx(0.985)
