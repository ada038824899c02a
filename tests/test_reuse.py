"""The Python blocks of the pages, as a reader would run them, and what they promise."""

import re
from pathlib import Path

import torch

REUSE = Path(__file__).parents[1] / "docs" / "reuse.md"


def run(heading):
    """What the block under a heading leaves behind."""
    torch.manual_seed(0)
    section = re.search(rf"^## {re.escape(heading)}$(.*?)(?=^## |\Z)", REUSE.read_text(), re.M | re.S).group(1)
    (block,) = re.findall(r"^```python\n(.*?)^```$", section, re.M | re.S)
    names = {}
    exec(compile(block, f"{REUSE.name}: {heading}", "exec"), names)
    return names


def gradients_reach(module):
    return all(param.grad is not None and param.grad.abs().sum() > 0 for param in module.parameters())


def test_configs_compose_an_environment_with_preferences():
    rollout = run("By config")["rollout"]
    assert rollout["next", "reward"].shape == (4, 3, 3)
    assert rollout["preference"].shape == (4, 3, 2)


def test_relabelling_redraws_three_quarters_of_the_preferences_under_any_key():
    names = run("Hindsight preferences in any replay buffer")
    assert abs(names["share"] - 0.75) < 0.05
    assert torch.equal(names["batch"]["taste"], names["batch"]["next", "taste"])


def test_the_interpolated_direction_lies_between_its_keys_neighbours():
    names = run("The preference interpolator alone")
    middle, last = torch.nn.functional.normalize(names["returns"][1:], dim=-1)
    direction = names["direction"]
    assert torch.isclose(direction.norm(), torch.tensor(1.0))
    assert middle[0] < direction[0] < last[0]
    assert last[1] < direction[1] < middle[1]


def test_the_loss_trains_networks_of_others():
    names = run("The loss with networks of your own")
    assert names["losses"]["pred_value"].shape == (2, 50, 2)
    (names["losses"]["loss_actor"] + names["losses"]["loss_qvalue"]).backward()
    assert gradients_reach(names["loss"].actor_network_params)
    assert gradients_reach(names["loss"].qvalue_network_params)


def test_the_learned_reward_prefers_what_the_policy_does_to_noise():
    names = run("A reward from ranked noise (D-REX) on another task")
    assert names["scores"]["accuracy"] > 0.7
    with torch.no_grad():
        reward = names["reward"](names["ranked"]["observation"][:, 4:], names["ranked"]["action"][:, 4:])
    assert reward[0].mean() > reward[-1].mean() + 0.1


def test_scalar_sac_learns_on_the_linearised_reward():
    names = run("The environment with another algorithm")
    assert names["env"].reward_spec.shape == (8, 1)
    (names["losses"]["loss_actor"] + names["losses"]["loss_qvalue"]).backward()
    assert gradients_reach(names["loss"].actor_network_params)
    assert gradients_reach(names["loss"].qvalue_network_params)


def test_gymnasium_finds_the_environment():
    names = run("The environment in Gymnasium")
    assert names["reward"].shape == (3,)
    assert names["envs"].num_envs == 1024


def test_torchrl_trains_the_loss():
    names = run("In TorchRL's own trainer")
    assert names["trainer"].collected_frames == 256
    assert all(torch.isfinite(weights).all() for weights in names["actor"].parameters())
