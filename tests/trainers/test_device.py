"""An update on an accelerator never waits for it: on "meta" there are no values, so whatever asks for one raises."""

import pytest
import torch
from support import configure
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from morlnav.modules import Actor
from morlnav.trainers.builders import bounds_of, make_base_env, make_loss, make_networks, make_replay

META = torch.device("meta")


def transitions(count=8, objectives=3, preferences=2):
    state = {
        "observation": torch.zeros(count, 34, device=META),
        "preference": torch.zeros(count, preferences, device=META),
    }
    flags = {key: torch.zeros(count, 1, dtype=torch.bool, device=META) for key in ("done", "terminated")}
    following = state | flags | {"reward": torch.zeros(count, objectives, device=META)}
    return TensorDict(state | {"action": torch.zeros(count, 2, device=META), "next": following}, [count], META)


@pytest.mark.parametrize("angle", ["safe", "paper"])
def test_an_update_never_waits_for_the_device(angle):
    cfg = configure(f"loss.angle={angle}", "loss.search.proposals=4", "trainer.products=bfloat16")
    env = make_base_env(cfg, num_envs=2)
    actor, critics = make_networks(cfg, env)
    clone = Actor(0, **bounds_of(env))
    for network in (actor, clone, *critics):
        network.to(META)
    env.__dict__["_device"] = META  # TorchRL's bounded specs cannot follow there
    policy = TensorDictModule(actor, ["observation", "preference"], ["action"])
    loss = make_loss(cfg, env, policy, critics, {"distance": clone})

    relabelled = make_replay(cfg, len(env.objectives)).transform(transitions())
    with pytest.raises(RuntimeError, match=r"item\(\) cannot be called"):
        bool(relabelled["next", "done"].any())
    for losses in (loss.value_loss, loss.actor_loss):
        value, metadata = losses(relabelled)
        value.backward()
        torch.nn.utils.clip_grad_norm_(list(loss.parameters()), 10.0)
        assert {entry.device.type for entry in (value, *metadata.values())} == {"meta"}
    assert {parameter.grad.device.type for parameter in loss.parameters() if parameter.requires_grad} == {"meta"}
