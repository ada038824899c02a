"""The updates of other libraries on the same shapes: TorchRL's stock TD3, and CAPQL and GPI-LS of morl-baselines."""

from __future__ import annotations

import os
from collections.abc import Callable

import gymnasium
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import MLP, ValueOperator
from torchrl.objectives import SoftUpdate, TD3Loss

os.environ.setdefault("WANDB_MODE", "disabled")  # morl-baselines imports wandb whether or not it logs


def torchrl_td3(
    rows: dict[str, Tensor], low: Tensor, high: Tensor, layers: list[int], batch_size: int = 256, delay: int = 2
) -> Callable[[], object]:
    """TorchRL's ``TD3Loss`` with a scalar reward, in the loop of its own ``sota-implementations``."""
    observations, actions = rows["observation"].shape[-1], low.numel()
    actor = nn.Sequential(MLP(observations, actions, num_cells=layers), nn.Tanh())
    critic = MLP(observations + actions, 1, num_cells=layers)
    loss = TD3Loss(
        TensorDictModule(actor, ["observation"], ["action"]),
        ValueOperator(critic, ["observation", "action"]),
        bounds=(low, high),
        loss_function="l2",
    ).to(low.device)
    loss.make_value_estimator(gamma=0.99)
    targets = SoftUpdate(loss, tau=0.005)
    actor_optimizer = torch.optim.Adam(loss.actor_network_params.values(True, True), lr=3e-4)
    critic_optimizer = torch.optim.Adam(loss.qvalue_network_params.values(True, True), lr=3e-4)
    replay = TensorDictReplayBuffer(
        storage=LazyTensorStorage(len(rows["reward"]), device=low.device), batch_size=batch_size
    )
    following = {
        "observation": rows["next_observation"],
        "reward": rows["reward"].sum(-1, keepdim=True),
        "done": rows["terminated"],
        "terminated": rows["terminated"],
    }
    replay.extend(
        TensorDict(
            {"observation": rows["observation"], "action": rows["action"], "next": following},
            batch_size=len(rows["reward"]),
        )
    )
    count = 0

    def step() -> None:
        nonlocal count
        count += 1
        batch = replay.sample()
        value_loss, _ = loss.value_loss(batch)
        value_loss.backward()
        critic_optimizer.step()
        critic_optimizer.zero_grad()
        if count % delay == 0:
            actor_loss, _ = loss.actor_loss(batch)
            actor_loss.backward()
            actor_optimizer.step()
            actor_optimizer.zero_grad()
            targets.step()

    return step


def capql_training(env: gymnasium.Env, device: str = "cpu", warm_up: int = 200) -> Callable[[], object]:
    """A step of CAPQL's ``train`` with its default settings: weights, action, environment, replay, update."""
    from morl_baselines.multi_policy.capql.capql import CAPQL, WeightSamplerAngle

    agent = CAPQL(env, log=False, seed=0, device=device)
    sampler = WeightSamplerAngle(agent.reward_dim, torch.pi / 8)
    observation, _ = env.reset(seed=0)

    def step(learn: bool = True) -> None:
        nonlocal observation
        weight = sampler.sample(1).view(-1).to(device)
        with torch.no_grad():
            seen = torch.tensor(observation).float().to(device)
            action = agent.policy.get_action(seen, weight).cpu().numpy()
        following, reward, terminated, truncated, _ = env.step(action)
        agent.replay_buffer.push(observation, action, weight.cpu().numpy(), reward, following, terminated)
        if learn:
            agent.update()
        observation = env.reset()[0] if terminated or truncated else following

    for _ in range(warm_up):
        step(learn=False)
    return step


def capql(
    env: gymnasium.Env, rows: dict[str, Tensor], layers: list[int], batch_size: int = 256
) -> Callable[[], object]:
    """The update of CAPQL; the actor is updated at every step."""
    from morl_baselines.multi_policy.capql.capql import CAPQL

    agent = CAPQL(env, net_arch=layers, batch_size=batch_size, log=False, seed=0, device=rows["reward"].device)
    weight = torch.full((agent.reward_dim,), 1 / agent.reward_dim).numpy()
    for observation, action, reward, following, terminated in _arrays(rows):
        agent.replay_buffer.push(observation, action, weight, reward, following, terminated.item())
    return agent.update


def gpi_ls(
    env: gymnasium.Env, rows: dict[str, Tensor], layers: list[int], batch_size: int = 256
) -> Callable[[], object]:
    """The update of morl-baselines' GPI-LS, with its prioritised replay, layer norm and dropout."""
    from morl_baselines.multi_policy.gpi_pd.gpi_pd_continuous_action import GPILSContinuousAction

    agent = GPILSContinuousAction(
        env,
        net_arch=layers,
        batch_size=batch_size,
        gradient_updates=1,
        buffer_size=len(rows["reward"]),
        log=False,
        seed=0,
        device=rows["reward"].device,
    )
    for observation, action, reward, following, terminated in _arrays(rows):
        agent.replay_buffer.add(observation, action, reward, following, terminated)
    corners = torch.eye(agent.reward_dim)
    agent.set_weight_support(list(corners.numpy()))
    return lambda: agent.update(corners[0].to(rows["reward"].device))


def _arrays(rows: dict[str, Tensor]) -> zip:
    return zip(*(column.cpu().numpy() for column in rows.values()), strict=True)
