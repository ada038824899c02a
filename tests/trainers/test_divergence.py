"""A learning that diverges ends with one sentence, and leaves nothing behind that is not finite."""

import json

import pytest
import torch
from support import configure, trainer_for
from torchrl.checkpoint import CheckpointRotation

import morlnav
from morlnav import deployment
from morlnav.commands.train import run
from morlnav.deployment.export import export_policy
from morlnav.modules import RewardModel, load_module, save_module

DIVERGING = "stepper.optimizer_critic.lr=1e30"


@pytest.fixture
def ruined(smoke_run):
    policy = morlnav.load(smoke_run)
    policy.actor.mlp[0].weight.data[0, 0] = torch.nan
    return policy


def test_divergence_is_named_before_the_evaluation(tmp_path):
    with pytest.raises(ValueError, match=r"Learning diverged: .* critics' weights are not finite after [\d,]+ frames"):
        run(configure(DIVERGING), tmp_path)
    assert not (tmp_path / "policy.pt").exists()
    assert not list((tmp_path / "checkpoints").glob("*"))


def test_the_last_checkpoint_is_named_and_resumes(tmp_path):
    cfg = configure("trainer.checkpoint_interval=1")
    trainer = trainer_for(cfg, tmp_path)

    def ruin():
        if trainer.collected_frames > 3 * cfg.collector.frames_per_batch:
            next(trainer.loss_module.actor_network_params.parameters()).data.fill_(torch.inf)

    trainer.register_op("post_optim", ruin)
    with pytest.raises(ValueError, match=r"the actor's weights .* lower stepper\.optimizer_actor\.lr") as error:
        trainer.train()
    trainer.collector.shutdown()
    latest = CheckpointRotation(tmp_path / "checkpoints", keep_last=1).latest()
    assert f"the last checkpoint, {latest}, is intact" in str(error.value)
    again = trainer_for(configure(), tmp_path / "again")
    again.load_from_file(latest)
    assert all(parameter.isfinite().all() for parameter in again.loss_module.parameters())
    again.collector.shutdown()


def test_a_ruined_policy_is_neither_saved_nor_loaded_nor_exported(ruined, smoke_run, tmp_path):
    with pytest.raises(ValueError, match=r"its mlp\.0\.weight is not finite"):
        deployment.save(ruined.actor, ruined.objectives, tmp_path)
    with pytest.raises(ValueError, match=r"its actor\.mlp\.0\.weight is not finite"):
        export_policy(ruined, tmp_path / "export", ("pt2",))
    assert not list(tmp_path.iterdir())
    description = json.loads((smoke_run / "policy.json").read_text())
    for name in ("sha256", "sha256_of_the_rest"):  # or they would be refused before
        del description[name]
    (tmp_path / "policy.json").write_text(json.dumps(description))
    torch.save(ruined.actor.state_dict(), tmp_path / "policy.pt")
    with pytest.raises(ValueError, match=r"policy\.pt cannot be used: its mlp\.0\.weight is not finite"):
        morlnav.load(tmp_path)


def test_a_ruined_reward_is_neither_saved_nor_loaded(tmp_path):
    model, path = RewardModel(["observation"], [-1.0], [1.0], features=3, depth=1), tmp_path / "reward.pt"
    save_module(model, path)
    torch.nn.init.constant_(model.mlp[0].bias, torch.nan)
    with pytest.raises(ValueError, match=r"reward\.pt cannot be used: its mlp\.0\.bias is not finite"):
        save_module(model, path)
    load_module(path)
    torch.save(model.state_dict(), path)
    description = json.loads(path.with_suffix(".json").read_text())
    for name in ("sha256", "sha256_of_the_rest"):
        del description[name]
    path.with_suffix(".json").write_text(json.dumps(description))
    with pytest.raises(ValueError, match=r"reward\.pt cannot be used: its mlp\.0\.bias is not finite"):
        load_module(path)
