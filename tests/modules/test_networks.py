import pytest
import torch
from support import configure, trainer_for
from torch import nn

from morlnav.modules import Actor, VectorCritic, round_products
from morlnav.modules.networks import StackableLinear

SIZES = {"action_low": [0.0, -3.0], "action_high": [0.5, 3.0], "features": 34}
INPUTS = torch.rand(7, 34), torch.rand(7, 2), torch.rand(7, 2)


def stacked(critics):
    names = dict(critics[0].named_parameters())
    return {name: torch.stack([dict(critic.named_parameters())[name] for critic in critics]) for name in names}


@pytest.mark.parametrize("shape", [{"depth": -1}, {"num_cells": 0}])
def test_impossible_networks_are_refused(shape):
    for make in (lambda: Actor(2, **SIZES, **shape), lambda: VectorCritic(3, 2, **SIZES, **shape)):
        with pytest.raises(ValueError, match="depth >= 0 and num_cells >= 1"):
            make()


@pytest.mark.parametrize("dtype", [None, torch.bfloat16])
def test_a_stack_of_critics_is_each_critic_alone(dtype):
    critics = [VectorCritic(3, 2, **SIZES, num_cells=32) for _ in range(3)]
    for critic in critics:
        round_products(critic, dtype)
    values = torch.func.functional_call(critics[0], stacked(critics), INPUTS)
    alone = torch.stack([critic(*INPUTS) for critic in critics])
    torch.testing.assert_close(values, alone, rtol=1e-2 if dtype else 1e-5, atol=1e-2 if dtype else 1e-5)


def test_only_hidden_products_are_rounded():
    critic = VectorCritic(3, 2, **SIZES, depth=3)
    exact = critic(*INPUTS)
    round_products(critic, torch.bfloat16)
    layers = [layer for layer in critic.mlp if isinstance(layer, nn.Linear)]
    assert [layer.dtype for layer in layers] == [None, torch.bfloat16, torch.bfloat16, None]
    assert critic(*INPUTS).dtype == torch.float32
    assert 0 < (critic(*INPUTS) - exact).abs().max() < 0.05
    round_products(critic, None)
    assert torch.equal(critic(*INPUTS), exact)


def test_rounded_products_give_nearly_the_same_gradients_in_full_precision():
    actor = Actor(2, **SIZES)
    gradients = []
    for dtype in (None, torch.bfloat16):
        round_products(actor, dtype)
        loss = (actor(*INPUTS[:2]) - 1).square().mean()
        gradients.append(torch.cat([g.flatten() for g in torch.autograd.grad(loss, list(actor.parameters()))]))
    assert gradients[1].dtype == torch.float32
    assert torch.cosine_similarity(*gradients, dim=0) > 0.99


def test_the_learner_rounds_but_the_policy_that_drives_and_is_kept_does_not(tmp_path):
    trainer = trainer_for(configure("products=bfloat16"), tmp_path)
    loss = trainer.loss_module

    def dtypes(module):
        return {layer.dtype for layer in module.modules() if isinstance(layer, StackableLinear)}

    assert dtypes(loss.actor_network) == dtypes(loss.qvalue_network) == {None, torch.bfloat16}
    assert dtypes(trainer.checkpoint.components["average"].module) == {None}
    assert dtypes(trainer.collector.policy) == {None}


def test_an_unknown_type_of_products_is_refused_in_one_sentence(tmp_path):
    with pytest.raises(ValueError, match=r"products must be one of auto, float32, bfloat16, got 'int8'\."):
        trainer_for(configure("products=int8"), tmp_path)
