"""An update on an accelerator never waits for it: on "meta" there are no values, so whatever asks for one raises."""

import pytest
import torch
from support import configure
from tensordict.nn import TensorDictModule

from morlnav.modules import Actor
from morlnav.trainers.builders import bounds_of, make_env, make_loss, make_networks, make_replay

META = torch.device("meta")


@pytest.mark.parametrize("angle", ["safe", "paper"])
def test_an_update_never_waits_for_the_device(angle):
    cfg = configure(f"loss.angle={angle}", "loss.search.proposals=4", "trainer.products=bfloat16")
    driving = make_env(cfg, num_envs=2)
    transitions, env = driving.rollout(4).reshape(-1).to(META), driving.base_env
    actor, critics = make_networks(cfg, env)
    clone = Actor(0, **bounds_of(env))
    for network in (actor, clone, *critics):
        network.to(META)
    env.__dict__["_device"] = META  # TorchRL's bounded specs cannot follow there
    policy = TensorDictModule(actor, ["observation", "preference"], ["action"])
    loss = make_loss(cfg, env, policy, critics, {"distance": clone})

    relabelled = make_replay(cfg, len(env.objectives)).transform(transitions)
    with pytest.raises(RuntimeError, match=r"item\(\) cannot be called"):
        bool(relabelled["next", "done"].any())
    for losses in (loss.value_loss, loss.actor_loss):
        value, metadata = losses(relabelled)
        value.backward()
        torch.nn.utils.clip_grad_norm_(list(loss.parameters()), 10.0)
        assert {entry.device.type for entry in (value, *metadata.values())} == {"meta"}
    assert {parameter.grad.device.type for parameter in loss.parameters() if parameter.requires_grad} == {"meta"}
