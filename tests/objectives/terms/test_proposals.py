"""Pulls toward a clone's and a search's actions, against values that are worked out critic by critic."""

import pytest
import torch
from small_losses import ACTION, HIGH, LOW, STATE, action_of, make_batch, make_loss, value_of
from tensordict.nn import TensorDictModule
from torch import nn

from morlnav.objectives import Guidance, LinearScalarisation, Proposals, Search


def imitate(sign=1):
    """A clone that does what it sees."""
    return TensorDictModule(lambda observation: sign * observation[..., :1].clamp(-2, 2), ["observation"], ["action"])


class Look(Search):
    """Proposes what it sees, or the opposite."""

    sign = 1

    def propose(self, acted):
        return self.sign * acted.batch["observation"][None, :, :1].clamp(-2, 2)


def proposing(search=None, guidance=None, clones=None, **options):
    """A loss with proposals and one clone, for the second of two objectives."""
    clones = {"style": imitate()} if clones is None else clones
    return make_loss(terms={"proposals": Proposals(search, guidance, clones, ["speed", "style"])}, **options)


def guided(**options):
    return proposing(guidance=Guidance(**{"coefficient": 0.5, "sharpness": 2.0, "margin": 0.0, **options}))


def test_guidance_pulls_toward_the_clone_where_the_other_objectives_agree():
    loss, batch = guided(), make_batch()
    plain, _ = make_loss().actor_loss(batch)
    total, metadata = loss.actor_loss(batch)
    action, proposal = action_of(loss, batch), batch["observation"][:, :1].clamp(-2, 2)
    gain = value_of(loss, batch, proposal) - value_of(loss, batch, action)
    agreed = (LinearScalarisation()(batch["preference"], 3) * gain)[:, :2].sum(-1) >= 0  # the third is guided
    expected = 0.5 * batch["preference"][:, 1] ** 2 * agreed * ((action - proposal) / 2).square().sum(-1)
    torch.testing.assert_close(metadata["proposals_actor"], expected)
    assert 0 < (expected > 0).sum() < len(batch)
    torch.testing.assert_close(total, plain + expected.mean())


def test_a_margin_decides_how_much_loss_guidance_may_cost():
    batch = make_batch()
    always, never = (guided(margin=margin).actor_loss(batch)[1]["proposals_actor"] for margin in (1e6, -1e6))
    assert (always > 0).all()
    assert (never == 0).all()


def test_a_search_pulls_at_every_preference_only_toward_what_is_clearly_better():
    batch = make_batch()
    loss = proposing(Look(coefficient=0.5, margin=-0.05))
    _, metadata = loss.actor_loss(batch)
    action, proposal = action_of(loss, batch), batch["observation"][:, :1].clamp(-2, 2)
    gain = value_of(loss, batch, proposal) - value_of(loss, batch, action)
    better = (LinearScalarisation()(batch["preference"], 3) * gain).sum(-1) >= 0.05
    expected = 0.5 * better * ((action - proposal) / 2).square().sum(-1)
    torch.testing.assert_close(metadata["proposals_actor"], expected)
    assert 0 < (expected > 0).sum() < len(batch)


def test_of_several_proposals_the_best_one_pulls():
    batch, levels = make_batch(), torch.tensor([-1.5, -0.5, 0.5, 1.5])
    search = Search(coefficient=0.5, margin=0.0, proposals=4)
    search.propose = lambda acted: levels.view(4, 1, 1).expand(4, *acted.action.shape)
    loss = proposing(search)
    _, metadata = loss.actor_loss(batch)

    def scalar(action):
        return (LinearScalarisation()(batch["preference"], 3) * value_of(loss, batch, action)).sum(-1)

    action = action_of(loss, batch)
    values = torch.stack([scalar(level.expand(len(batch), 1)) for level in levels])
    best = levels[values.argmax(0)].unsqueeze(-1)
    expected = 0.5 * (values.max(0).values >= scalar(action)) * ((action - best) / 2).square().sum(-1)
    torch.testing.assert_close(metadata["proposals_actor"], expected)
    assert expected.any()
    assert len(best.unique()) > 1


def test_a_clone_is_silent_where_the_critic_objects_or_a_search_knows_better():
    batch = make_batch()
    ahead = Look(coefficient=0.0, margin=0.0)
    ahead.sign = -1
    _, metadata = proposing(ahead, Guidance(sharpness=0.0, margin=0.01)).actor_loss(batch)

    loss = make_loss()
    action, proposal = action_of(loss, batch), batch["observation"][:, :1].clamp(-2, 2)
    weights = LinearScalarisation()(batch["preference"], 3)
    own, cloned, searched = (weights * value_of(loss, batch, act) for act in (action, proposal, -proposal))
    others = (cloned - own)[:, :2].sum(-1)  # the third is guided
    known = (searched - own).sum(-1).clamp(min=0)
    expected = 0.3 * (others - known >= -0.01) * ((action - proposal) / 2).square().sum(-1)
    torch.testing.assert_close(metadata["proposals_actor"], expected)
    assert 0 < (expected > 0).sum() < (others >= -0.01).sum() < len(batch)


def test_guidance_teaches_the_actor_and_leaves_clone_and_critics_alone():
    torch.manual_seed(0)
    clone = TensorDictModule(nn.Linear(STATE, ACTION), ["observation"], ["action"])
    loss = proposing(Search(margin=1e6), Guidance(margin=1e6, sharpness=0.0), {"style": clone})
    loss.actor_loss(make_batch())[0].backward()
    assert all(parameter.grad is None for parameter in clone.parameters())
    assert all(parameter.grad is None for parameter in loss.qvalue_network_params.parameters())
    assert all(parameter.grad is not None for parameter in loss.actor_network_params.parameters())


def test_clones_and_search_pull_together_each_with_the_strength_that_it_has_alone():
    batch, guidance = make_batch(), Guidance(margin=1e6, sharpness=1.0)
    search = Look(coefficient=0.5, margin=1e6)
    clones = {"style": imitate(), "speed": imitate(-1)}
    both, cloned, style, speed, searched = (
        proposing(*parts).actor_loss(batch)[1]["proposals_actor"]
        for parts in (
            (search, guidance, clones),
            (None, guidance, clones),
            (None, guidance, {"style": clones["style"]}),
            (None, guidance, {"speed": clones["speed"]}),
            (search, None, clones),
        )
    )
    torch.testing.assert_close(cloned, style + speed)
    torch.testing.assert_close(both, cloned + searched)
    assert min(style.min(), speed.min(), searched.min()) > 0


def test_a_search_draws_uniformly_within_the_bounds_from_the_global_random_state():
    seen = []

    class Watched(Search):
        def propose(self, acted):
            seen.append(super().propose(acted))
            return seen[-1]

    loss, batch = proposing(Watched(proposals=50)), make_batch(count=40)
    for _ in range(2):
        torch.manual_seed(0)
        loss.actor_loss(batch)
    assert torch.equal(*seen)
    assert seen[0].shape == (50, 40, ACTION)
    assert ((seen[0] >= LOW) & (seen[0] <= HIGH)).all()
    torch.testing.assert_close(seen[0].mean(), torch.tensor(0.0), atol=0.1, rtol=0)
    torch.testing.assert_close(seen[0].std(), torch.tensor(4 / 12**0.5), atol=0.05, rtol=0)


def test_what_clones_read_is_asked_of_the_batch():
    clone = TensorDictModule(lambda seen: seen[..., :1], ["camera"], ["action"])
    loss = proposing(guidance=Guidance(), clones={"style": clone})
    assert "camera" in loss.in_keys
    assert "camera" not in proposing(clones={"style": clone}).in_keys  # without guidance it is not asked


def test_with_nothing_to_propose_nothing_is_added():
    loss, plain = proposing(clones={}), make_loss()
    assert loss.out_keys == plain.out_keys
    batch = make_batch()
    assert torch.equal(loss.actor_loss(batch)[0], plain.actor_loss(batch)[0])


def test_wrong_settings_are_named():
    for make, sentence in (
        (lambda: Search(proposals=0), "proposals must be at least 1, got 0"),
        (lambda: Search(coefficient=-1.0), "must not be negative, got -1.0"),
        (lambda: Guidance(coefficient=-1.0), "coefficient must not be negative, got -1.0"),
        (
            lambda: Proposals(None, Guidance(), {"demo": imitate()}, ["speed", "style"]),
            "There is a clone for demo, but objectives are speed, style",
        ),
    ):
        with pytest.raises(ValueError, match=sentence):
            make()
