"""D-REX on gymnasium's Pendulum-v1: a reward from 20 demonstrations, and a policy that outdoes the demonstrator."""

import gymnasium
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, EnvBase, GymWrapper, InitTracker, TransformedEnv
from torchrl.modules import MLP, TanhModule
from torchrl.objectives import SoftUpdate, TD3Loss

from morlnav.data import SnippetPairs, roll_out_ranked
from morlnav.modules import EpsilonGreedyNoise, NormalisedReward, RewardModel
from morlnav.objectives import BehaviourCloningLoss, RankingLoss
from morlnav.trainers.supervised import fit
from morlnav.transforms import DemonstrationReward

LOW, HIGH, STEPS = torch.tensor([-2.0]), torch.tensor([2.0]), 200


def make_env(count: int, seed: int) -> EnvBase:
    """Pendulums side by side."""
    mode = {"autoreset_mode": gymnasium.vector.AutoresetMode.DISABLED}
    env = GymWrapper(gymnasium.make_vec("Pendulum-v1", count, vectorization_mode="sync", vector_kwargs=mode))
    env.set_seed(seed)
    return env


def demonstrate(observation: torch.Tensor) -> torch.Tensor:
    """Swing up with a quarter of the torque, by energy, then balance."""
    cos, sin, speed = observation.split(1, -1)
    swing = (-0.1 * speed * (speed**2 / 2 + 15 * (cos - 1))).clamp(-0.5, 0.5)
    return torch.where(cos > 0.8, -12 * sin - 3 * speed, swing).clamp(-2, 2)


def main(seed: int = 0) -> dict[str, float]:
    """Mean true return of demonstrator, clone and trained policy from the same 100 held-out starting states."""
    torch.manual_seed(seed)
    expert = TensorDictModule(demonstrate, ["observation"], ["action"])
    mlps = [MLP(n, 1, num_cells=[cells, cells], activation_class=torch.nn.ReLU) for n, cells in ((3, 64), (3, 64), (4, 128))]
    heads = [TensorDictModule(mlp, ["observation"], ["action"]) for mlp in mlps[:2]]
    clone, policy = (TensorDictSequential(head, TanhModule(["action"], low=LOW, high=HIGH)) for head in heads)
    critic = TensorDictModule(mlps[2], ["observation", "action"], ["state_action_value"])

    demos = make_env(20, seed).rollout(STEPS, expert).select("observation", "action")
    train, held_out = demos[:16].flatten(), demos[16:].flatten()
    cloning = BehaviourCloningLoss(clone, bounds=(LOW, HIGH))
    fit(cloning, lambda: train[torch.randint(len(train), (256,))], held_out, steps=3000, lr=3e-3)

    levels = [0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0]
    noisy = roll_out_ranked(
        lambda observation: clone(observation=observation), lambda count: make_env(count, seed + 1),
        lambda epsilon: EpsilonGreedyNoise(epsilon, LOW, HIGH), levels, episodes=20, max_steps=STEPS,
    )
    pairs, unseen = (SnippetPairs(part, length=20) for part in (noisy[:, :16], noisy[:, 16:]))
    model = RewardModel(["observation"], LOW, HIGH, depth=2, num_cells=64, in_features=3)
    ranking = RankingLoss(TensorDictModule(model, ["observation", "action"], ["reward"]))
    fit(ranking, lambda: pairs.sample(64), unseen.sample(1000), steps=1000)
    rows = noisy.flatten()
    model = NormalisedReward(model).fit(rows["observation"], rows["action"], torch.arange(len(rows)) < len(noisy[0]) ...)
