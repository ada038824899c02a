import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from morlnav.objectives import BehaviourCloningLoss
from morlnav.trainers import Fit

BOUNDS = (-torch.ones(1), torch.ones(1))


def regression(rows: int) -> TensorDict:
    x = torch.rand(rows, 1)
    return TensorDict(observation=x, action=0.5 * x - 0.2, batch_size=[rows])


def make_loss() -> tuple[nn.Module, BehaviourCloningLoss]:
    network = nn.Linear(1, 1)
    return network, BehaviourCloningLoss(TensorDictModule(network, ["observation"], ["action"]), bounds=BOUNDS)


def test_it_learns_a_linear_policy():
    torch.manual_seed(0)
    network, loss = make_loss()
    fit = Fit(steps=400, lr=0.05, weight_decay=0.0)
    scores = fit(loss, lambda: regression(64), regression(64))
    assert scores["loss_bc"] < 1e-5
    torch.testing.assert_close(network.weight.item(), 0.5, atol=0.02, rtol=0)


def test_the_best_weights_are_kept_and_it_stops_early():
    torch.manual_seed(0)
    network, loss = make_loss()
    calls = []

    def misleading() -> TensorDict:  # trains away from the held-out data
        calls.append(1)
        data = regression(64)
        return data.set("action", data["action"] + 10)

    before = loss(held_out := regression(64))["loss_bc"].item()
    scores = Fit(steps=500, interval=1, patience=3)(loss, misleading, held_out)
    assert len(calls) < 500
    assert loss(held_out)["loss_bc"].item() == pytest.approx(scores["loss_bc"])
    assert scores["loss_bc"] >= before or network.bias.item() != 0


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"steps": 0}, "steps must be at least 1, got 0"),
        ({"steps": 1, "interval": 0}, "interval must be at least 1, got 0"),
        ({"steps": 1, "patience": 0}, "patience must be at least 1, got 0"),
        ({"steps": 1, "lr": 0.0}, "lr must be positive"),
        ({"steps": 1, "weight_decay": -0.1}, "weight_decay must not be negative"),
    ],
)
def test_numbers_out_of_range_are_refused(settings, sentence):
    with pytest.raises(ValueError, match=sentence):
        Fit(**settings)


def test_nothing_held_out_is_refused():
    with pytest.raises(ValueError, match="no held-out data"):
        Fit(steps=1)(make_loss()[1], lambda: regression(4), regression(0))


def test_a_loss_that_is_no_number_is_named_at_once():
    broken = regression(4).apply(lambda tensor: tensor * torch.nan)
    with pytest.raises(ValueError, match="fit diverged: its held-out loss is nan after 1 steps"):
        Fit(steps=50, interval=1)(make_loss()[1], lambda: regression(4), broken)
