"""MORL-TD3 on a continuous task of MO-Gymnasium, in TorchRL's stock trainer: one policy for all preferences.

python examples/mo_gymnasium_td3.py                            # mo-mountaincarcontinuous-v0
python examples/mo_gymnasium_td3.py mo-hopper-v5 --frames 500000   # needs gymnasium[mujoco]
"""

import argparse

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, DoubleToFloat, InitTracker, MOGymEnv, ObservationNorm, TransformedEnv
from torchrl.objectives import SoftUpdate
from torchrl.trainers.algorithms.td3 import TD3OptimizationStepper, TD3Trainer

from morlnav import HindsightPreferenceRelabel, MORLTD3Loss
from morlnav.data import CornerWeightedPreferences, simplex_grid
from morlnav.modules import Actor, EpsilonGreedyNoise, VectorCritic
from morlnav.transforms import DrawPreference


def main(
    task: str = "mo-mountaincarcontinuous-v0", frames: int = 40_000, seed: int = 0, max_steps: int = 1000
) -> dict[str, list[float]]:
    """Train, and return what the policy earns of each objective under preferences from corner to corner."""
    torch.manual_seed(seed)
    env = MOGymEnv(task)
    num_objectives, size = env.reward_spec.shape[-1], env.observation_spec["observation"].shape[-1]
    low, high = env.action_spec.space.low, env.action_spec.space.high
    sampler = CornerWeightedPreferences(num_objectives)
    norm = ObservationNorm(in_keys=["observation"], standard_normal=True)
    env = TransformedEnv(env, Compose(DoubleToFloat(), norm, InitTracker(), DrawPreference(sampler)))
    env.set_seed(seed)
    norm.init_stats(max_steps)

    keys = ["observation", "preference"]
    settings = {"action_low": low, "action_high": high, "depth": 2, "num_cells": 128}
    actor = TensorDictModule(Actor(num_objectives, features=torch.nn.Linear(size, 64), **settings), keys, ["action"])
    critics = [
        TensorDictModule(
            VectorCritic(num_objectives, num_objectives, features=torch.nn.Linear(size, 64), **settings),
            [*keys, "action"],
            ["state_action_value"],
        )
        for _ in range(2)
    ]
    loss = MORLTD3Loss(actor, critics, bounds=(low, high))
    loss.make_value_estimator(gamma=0.99)

    noise = TensorDictModule(EpsilonGreedyNoise(0.5, low, high, hold=20), ["action", "is_init"], ["action"])
    collector = Collector(env, TensorDictSequential(actor, noise), frames_per_batch=64, total_frames=frames)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(200_000), batch_size=256, transform=HindsightPreferenceRelabel(sampler)
    )
    optimizers = [
        torch.optim.Adam(params.parameters(), lr=1e-3)
        for params in (loss.actor_network_params, loss.qvalue_network_params)
    ]
    TD3Trainer(
        collector=collector,
        total_frames=frames,
        frame_skip=1,
        optim_steps_per_batch=8,
        loss_module=loss,
        optimization_stepper=TD3OptimizationStepper(*optimizers),
        replay_buffer=buffer,
        target_net_updater=SoftUpdate(loss, tau=0.005),
        exploration_module=noise,
        log_rewards=False,
    ).train()
    returns = {}
    for preference in simplex_grid(num_objectives, 2):
        start = env.reset(TensorDict(preference=preference))
        rollout = env.rollout(max_steps, actor, auto_reset=False, tensordict=start)
        returns[str(preference.tolist())] = rollout["next", "reward"].sum(0).tolist()
    return returns


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", nargs="?", default="mo-mountaincarcontinuous-v0")
    parser.add_argument("--frames", type=int, default=40_000)
    try:
        learned = main(**vars(parser.parse_args()))
    except ValueError as error:  # such as actions without bounds
        raise SystemExit(error) from error
    for preference, reward in learned.items():
        print(preference, reward)
