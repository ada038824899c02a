"""How a learned reward judges a demonstrator under growing noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
import scipy
import torch
from tensordict import TensorDict
from torch import Tensor

from morlnav.data import roll_out_ranked
from morlnav.modules import EpsilonGreedyNoise
from morlnav.navigation.envs import Collision, GoalProgress, NavigationEnv, Sum
from morlnav.navigation.evaluation.statistics import bootstrap_interval
from morlnav.navigation.world import Scene, TensorWorld, World, without_human
from morlnav.transforms import DemonstrationReward


def noisy_rollouts(
    policy: Callable[[Tensor], Tensor],
    scenes: Scene,
    levels: Sequence[float] = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5),
    hold: int = 10,
    *,
    world: World | None = None,
    max_steps: int = 250,
    seed: int = 0,
) -> TensorDict:
    """Drive a policy under every noise level in every scene, all side by side (Sec. III-C, Fig. 2).

    Args:
        policy: maps raw observations ``[B, 34]`` to actions ``[B, 2]``.
        scenes: batched ``[S]``.
        levels: noise levels ``ε``, ascending.
        hold: steps that a random action lasts.
        world: the engine; tensors by default.
        max_steps: time limit.
        seed: of the noise; torch's global random state is left alone.

    Returns:
        ``[levels, S, T]`` as from :func:`~morlnav.data.roll_out_ranked`; the reward is the baseline's.

    Examples:
        >>> from morlnav.navigation.evaluation import evaluation_scenes
        >>> from morlnav.navigation.modules import CircumnavigationOracle
        >>> noisy_rollouts(CircumnavigationOracle(), evaluation_scenes(3), (0.0, 0.5), max_steps=5).batch_size
        torch.Size([2, 3, 5])
    """
    world = world or TensorWorld()
    everywhere = torch.cat([scenes] * len(levels))
    baseline = {"baseline": Sum([GoalProgress(), Collision()], static=True)}
    low, high = world.robot.action_low, world.robot.action_high
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return roll_out_ranked(
            policy,
            lambda count: NavigationEnv(world, lambda *_, **__: everywhere, baseline, num_envs=count, seed=seed),
            lambda epsilon: EpsilonGreedyNoise(epsilon, low, high, hold).to(epsilon.device),
            levels,
            len(scenes),
            max_steps,
        )


@torch.no_grad()
def judge_noise(
    rollouts: TensorDict,
    demo: DemonstrationReward,
    levels: Sequence[float],
    snippet: int = 5,
    temperature: float = 10.0,
    *,
    observe_human: bool = True,
    num_pairs: int = 20000,
    seed: int = 0,
) -> tuple[pd.DataFrame, pd.DataFrame, dict[str, float]]:
    """What the reward says of noisy roll-outs, against the noise and the true baseline return, normalised as in Fig. 2.

    Args:
        rollouts: ``[levels, S, T]`` from :func:`noisy_rollouts`.
        demo: the learned reward, as it is paid.
        levels: the noise levels ``ε``.
        snippet: steps of the snippets that are compared.
        temperature: the logit of a pair is this times the difference of mean ``R̂``.
        observe_human: whether the reward sees the human's position.
        num_pairs: snippets to compare.
        seed: of snippets and bootstrap.

    Returns:
        The frames ``noise`` and ``calibration`` of an :class:`~morlnav.navigation.audit.Audit`, and its facts on noise.
    """
    rng = np.random.default_rng(seed)
    mask = rollouts["mask"].cpu()
    observation, action = rollouts["observation"][rollouts["mask"]], rollouts["action"][rollouts["mask"]]
    if not observe_human:
        observation = without_human(observation)
    reward = torch.zeros(mask.shape, dtype=torch.float64)
    parts = zip(observation.split(65536), action.split(65536), strict=True)
    reward[mask] = torch.cat([demo.reward_model(*part) for part in parts]).double().cpu()
    steps = mask.sum(-1)
    mean = reward.sum(-1) / steps
    # A fraction, as long ways would otherwise count as good driving.
    most = GoalProgress().scale * rollouts["observation"][..., 0, 0].cpu()
    baseline = (rollouts["reward"][..., 0].cpu() * mask).sum(-1) / most
    predicted = demo.scale * (reward.sum(-1) + demo.offset * steps)

    rows = []
    for level, values, returns, lengths in zip(levels, mean, baseline, steps, strict=True):
        low, high = bootstrap_interval(values.numpy(), rng)
        row = {"epsilon": level, "mean_reward": values.mean(), "mean_reward_low": low, "mean_reward_high": high}
        rows.append(row | {"baseline": returns.mean(), "steps": lengths.double().mean()})
    noise = pd.DataFrame(rows).astype(float)
    calibration, facts = _calibrate(reward, steps, snippet, temperature, num_pairs, rng)
    return (
        noise,
        calibration,
        {
            "noise_correlation": _spearman(noise["epsilon"], noise["mean_reward"]),
            "return_spearman": _spearman(predicted.flatten(), baseline.flatten()),
            "return_kendall": float(scipy.stats.kendalltau(predicted.flatten(), baseline.flatten()).statistic),
            "mean_spearman": _spearman(mean.flatten(), baseline.flatten()),
            "length_spearman": _spearman(mean.flatten(), steps.flatten()),
            **facts,
        },
    )


def _calibrate(
    reward: Tensor, steps: Tensor, snippet: int, temperature: float, num_pairs: int, rng: np.random.Generator
) -> tuple[pd.DataFrame, dict[str, float]]:
    """Predicted and actual chances that the first of two random snippets has less noise, in ten bins."""
    total = np.pad(reward.numpy().cumsum(-1), ((0, 0), (0, 0), (1, 0)))
    level, episode = np.nonzero(steps.numpy() >= snippet)
    first, second = rng.integers(len(level), size=(2, 2 * num_pairs))
    differs = np.nonzero(level[first] != level[second])[0][:num_pairs]

    def mean(chosen: np.ndarray) -> np.ndarray:
        where = level[chosen], episode[chosen]
        start = rng.integers(steps.numpy()[where] - snippet + 1)
        return (total[(*where, start + snippet)] - total[(*where, start)]) / snippet

    first, second = first[differs], second[differs]
    logit = temperature * (mean(first) - mean(second))
    better, chance = level[first] < level[second], 1 / (1 + np.exp(-logit))
    frame = pd.DataFrame({"bin": np.minimum((10 * chance).astype(int), 9), "predicted": chance, "empirical": better})
    table = frame.groupby("bin").agg(
        predicted=("predicted", "mean"), empirical=("empirical", "mean"), pairs=("bin", "size")
    )
    accuracy = np.where(logit == 0, 0.5, (logit > 0) == better).mean()
    error = ((table["predicted"] - table["empirical"]).abs() * table["pairs"]).sum() / table["pairs"].sum()
    return table.reset_index(drop=True), {"pair_accuracy": float(accuracy), "calibration_error": float(error)}


def _spearman(first: Tensor | pd.Series, second: Tensor | pd.Series) -> float:
    first, second = np.asarray(first, float), np.asarray(second, float)
    return float(scipy.stats.spearmanr(first, second).statistic) if np.ptp(first) and np.ptp(second) else float("nan")
