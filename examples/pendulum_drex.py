"""D-REX on gymnasium's Pendulum-v1: a reward from 20 demonstrations, and a policy that outdoes the demonstrator."""

import gymnasium
import torch
import torchrl.collectors
from tensordict.nn import TensorDictModule, TensorDictSequential

from morlnav import data, modules, objectives, transforms
from morlnav.trainers import Fit

LOW, HIGH, LEVELS = torch.tensor([-2.0]), torch.tensor([2.0]), [0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0]


def _pendulums(count: int, seed: int) -> torchrl.envs.EnvBase:
    vector = gymnasium.make_vec("Pendulum-v1", count, "sync", vector_kwargs={"autoreset_mode": "Disabled"})
    (env := torchrl.envs.GymWrapper(vector)).set_seed(seed)
    return env


def _demonstrate(observation: torch.Tensor) -> torch.Tensor:  # swing up with a quarter of the torque, then balance
    cos, sin, speed = observation.split(1, -1)
    swing = (-0.1 * speed * (speed**2 / 2 + 15 * (cos - 1))).clamp(-0.5, 0.5)
    return torch.where(cos > 0.8, -12 * sin - 3 * speed, swing).clamp(-2, 2)


def main(seed: int = 0) -> list[float]:
    """Mean true returns of demonstrator, clone and policy from the same 100 starting states, unseen in training."""
    torch.manual_seed(seed)
    actors = [modules.Actor(0, LOW, HIGH, torch.nn.Linear(3, 64), depth=2, num_cells=64) for _ in range(2)]
    nets = [TensorDictModule(net, ["observation"], ["action"]) for net in (_demonstrate, *actors)]
    demos = _pendulums(20, seed).rollout(200, nets[0]).select("observation", "action")
    loss, train = objectives.BehaviourCloningLoss(nets[1], bounds=(LOW, HIGH)), demos[:16].flatten()
    Fit(steps=3000, lr=3e-3)(loss, lambda: train[torch.randint(len(train), (256,))], demos[16:].flatten())
    noise, envs = lambda e, hold=1: modules.EpsilonGreedyNoise(e, LOW, HIGH, hold), lambda n: _pendulums(n, seed + 1)
    noisy = data.roll_out_ranked(actors[0], envs, noise, LEVELS, episodes=20)
    pairs, unseen = (data.SnippetPairs(part, length=20) for part in (noisy[:, :16], noisy[:, 16:]))
    reward = modules.RewardModel(["observation"], LOW, HIGH, features=3, depth=2, num_cells=64)
    loss = objectives.RankingLoss(TensorDictModule(reward, ["observation", "action"], ["reward"]))
    Fit(steps=1000)(loss, lambda: pairs.sample(64), unseen.sample(1000))
    reward = modules.NormalisedReward(reward).fit(noisy["observation"].flatten(0, 2), None, torch.arange(32000) < 4000)
    learned = transforms.DemonstrationReward(reward, scale=1.0, offset=0.0, entry=0, insert=False)
    env = torchrl.envs.TransformedEnv(_pendulums(16, seed + 2), learned)
    driver = TensorDictSequential(nets[2], TensorDictModule(noise(torch.linspace(0, 1, 16), 5), ["action"], ["action"]))
    critic = torchrl.modules.ValueOperator(torchrl.modules.MLP(4, 1, num_cells=[128, 128]), ["observation", "action"])
    loss = torchrl.objectives.TD3Loss(nets[2], critic, bounds=(LOW, HIGH), deactivate_vmap=True)
    loss.make_value_estimator(gamma=0.98)
    target, optimizer = torchrl.objectives.SoftUpdate(loss, tau=0.01), torch.optim.Adam(loss.parameters(), lr=1e-3)
    buffer = torchrl.data.ReplayBuffer(storage=torchrl.data.LazyTensorStorage(28_000), batch_size=64)
    runs = torchrl.collectors.Collector(env, driver, frames_per_batch=64, total_frames=112_000, replay_buffer=buffer)
    for _ in runs:
        optimizer.zero_grad()
        sum(loss(buffer.sample()).select("loss_actor", "loss_qvalue").values()).backward()
        optimizer.step()
        target.step()
    return [_pendulums(100, 1000).rollout(200, net)["next", "reward"].sum(1).mean().item() for net in nets]


if __name__ == "__main__":
    print(main())
