"""CAPQL and GPI-LS of morl-baselines drive the robot, and are evaluated in the scenes that our policies are judged in.

    python -m benchmarks.peers.agents capql --minutes 12
    python -m benchmarks.peers.agents gpi_ls --minutes 12
    python -m benchmarks.peers.agents compare results/two_styles/seed_0 results/peers/capql results/peers/gpi_ls

Both agents are morl-baselines' own, unchanged, with their own defaults but for what SETTINGS says. They get what helps
our learner: the features that our networks look through, and rewards in the learner's unit. The time is that of one
core, so that a busy machine takes nothing from them; on a free one it is the time on the wall.
"""

import argparse
import json
import os
import time
from pathlib import Path

os.environ.setdefault("WANDB_MODE", "disabled")  # morl-baselines imports wandb whether or not it logs

import gymnasium
import numpy as np
import pandas as pd
import torch
from gymnasium.wrappers import TransformObservation, TransformReward
from morl_baselines.multi_policy.capql.capql import CAPQL
from morl_baselines.multi_policy.gpi_pd.gpi_pd_continuous_action import GPILSContinuousAction
from torch import Tensor

from morlnav.cli import one_sentence_errors, quiet
from morlnav.data import preference_edges
from morlnav.evaluation import expected_utility, hypervolume, reference_from_bounds
from morlnav.navigation.envs import ENV_ID, NavigationEnv, Objective, default_objectives
from morlnav.navigation.evaluation import evaluate_policy, evaluation_scenes, reference_paths, write_report
from morlnav.navigation.modules import CircumnavigationOracle, NavigationFeatures
from morlnav.record.markdown import markdown_table

AGENTS = {"capql": CAPQL, "gpi_ls": GPILSContinuousAction}
SETTINGS = {"capql": {}, "gpi_ls": {"gradient_updates": 1}}
"""Settings that differ from the agents' defaults: GPI-LS's usual twenty updates per step leave time for few steps."""

TRAINING = {
    "capql": {"num_eval_weights_for_front": 3},
    "gpi_ls": {
        "num_eval_weights_for_front": 3,
        "timesteps_per_iter": 2500,
        "num_eval_episodes_for_front": 2,
        "checkpoints": False,
    },
}
"""Arguments of their ``train``. GPI-LS chooses new weights after every iteration; its usual 10,000 steps would leave
time for two of them. The front's weights are for logs that are not written."""

REWARD_SCALE = 0.01


class TimeUp(Exception):
    """Raised by the environment when the time is over; the agents know limits of steps only."""


class Clock:
    """Seconds of the processor that this process may have from its first step on."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.start = seconds, None

    def check(self) -> None:
        """Start the clock, or raise :class:`TimeUp`."""
        self.start = self.start if self.start is not None else time.process_time()
        if time.process_time() - self.start > self.seconds:
            raise TimeUp


class Timed(gymnasium.Wrapper):
    """Lets an agent drive until the clock says that its time is up, and counts its steps."""

    def __init__(self, env: gymnasium.Env, clock: Clock) -> None:
        super().__init__(env)
        self.clock, self.steps = clock, 0

    def step(self, action: np.ndarray) -> tuple:
        """One step, or :class:`TimeUp`."""
        self.clock.check()
        self.steps += 1
        return self.env.step(action)


def make_env(objectives: dict[str, Objective], clock: Clock) -> Timed:
    """Our environment with features for observations and rewards in the learner's unit."""
    env, features = gymnasium.make(ENV_ID, objectives=objectives), NavigationFeatures()
    space = gymnasium.spaces.Box(-np.inf, np.inf, (features.out_features,), np.float32)
    env = TransformObservation(env, lambda seen: features(torch.from_numpy(seen)).numpy(), space)
    return Timed(TransformReward(env, lambda reward: REWARD_SCALE * reward), clock)


class Policy:
    """``policy(observation [B, 34], preference [B, n]) -> action [B, 2]``; static ones weigh as much as all others."""

    def __init__(self, agent: CAPQL | GPILSContinuousAction, num_objectives: int) -> None:
        self.agent, self.features, self.num_objectives = agent, NavigationFeatures(), num_objectives

    def __call__(self, observation: Tensor, preference: Tensor) -> Tensor:
        """Actions for raw observations."""
        static = preference.new_ones(*preference.shape[:-1], self.num_objectives - preference.shape[-1])
        weights = torch.cat([static, preference], -1)
        weights = weights / weights.sum(-1, keepdim=True)  # the agents' weights sum to one
        return self.agent.eval(self.features(observation), weights, torch_action=True)


def train(name: str, seconds: float, objectives: dict[str, Objective], seed: int = 0, **settings: object) -> tuple:
    """Train one of :data:`AGENTS` with so many seconds of one core; returns the agent and a record of the training."""
    torch.manual_seed(seed)
    clock = Clock(seconds)
    env, eval_env = make_env(objectives, clock), make_env(objectives, clock)
    settings = SETTINGS[name] | settings
    agent = AGENTS[name](env, seed=seed, log=False, device="cpu", **settings)
    env.reset(seed=seed)
    try:
        agent.train(10**9, eval_env, ref_point=None, **TRAINING[name])
    except (TimeUp, KeyboardInterrupt):
        agent.use_gpi = False  # as GPI-LS acts with continuous actions, also if time was up while it chose weights
    steps = {"environment_steps": env.steps, "evaluation_steps": eval_env.steps}
    return agent, {"agent": name, "seconds": seconds, "seed": seed, **steps, **settings}


def evaluate(policy: Policy, objectives: dict[str, Objective], directory: Path, episodes: int, steps: int) -> str:
    """Write our report of the policy: the scenes and preferences of ``morlnav-evaluate``."""
    tuneable = sum(not getattr(term, "static", False) for term in objectives.values())
    scenes = evaluation_scenes(episodes, seed=12345)
    rollouts = evaluate_policy(policy, scenes, preference_edges(tuneable, steps), objectives=objectives)
    references = reference_paths(scenes, CircumnavigationOracle())
    bounds = NavigationEnv(objectives=objectives).reward_bounds
    reference = reference_from_bounds(bounds, max_steps=250)  # as evaluate_policy drives
    return write_report(rollouts, directory, tuple(objectives), references=references, reference_point=reference)


def compare(runs: list[Path]) -> str:
    """A Markdown table of evaluated runs, ours or theirs, that have the same objectives.

    Raises:
        ValueError: without runs.
        FileNotFoundError: for a run without an evaluation.
    """
    if not runs:
        raise ValueError("compare needs run directories with an evaluation.")
    lines = []
    for run in runs:
        summary, front = (pd.read_csv(run / "evaluation" / f"{name}.csv") for name in ("summary", "front"))
        far, fast = (summary[summary[f"lambda_{name}"] == 1].iloc[0] for name in ("distance", "efficiency"))
        line = {"run": run.as_posix(), **{f"{name} %": f"{summary[name].mean():.1f}" for name in ("SR", "CR", "TR")}}
        line |= {"min d_h at distance": f"{far['min_human_distance']:.2f} m"}
        line |= {"time at efficiency": "–" if pd.isna(fast["navigation_time"]) else f"{fast['navigation_time']:.1f} s"}
        line |= _quality(front)
        lines.append(line)
    return markdown_table(lines[0], (line.values() for line in lines), ("--",))


def _quality(front: pd.DataFrame) -> dict[str, str]:
    """Hypervolume and expected utility, with one reference point and the weights ``(1, λ)`` for all runs."""
    returns, preferences = (torch.tensor(front.filter(regex=f"^{kind}_").values) for kind in ("return", "lambda"))
    reference = reference_from_bounds(NavigationEnv().reward_bounds, max_steps=250)
    volume, utility = hypervolume(returns, reference.double()), expected_utility(returns, preferences)
    return {"hypervolume": f"{volume:.3g}", "utility": f"{utility:.0f}"}


def main(words: list[str] | None = None) -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers.agents", description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=[*AGENTS, "compare"])
    parser.add_argument("runs", type=Path, nargs="*", help="for compare: run directories with an evaluation")
    parser.add_argument("--minutes", type=float, default=12.0, help="time of the training on one core")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=100, help="scenes of the evaluation")
    parser.add_argument("--steps", type=int, default=10, help="steps between preferences")
    parser.add_argument("--output", type=Path, default=Path("results/peers"))
    args = parser.parse_args(words)
    with one_sentence_errors():
        if args.what == "compare":
            args.output.mkdir(parents=True, exist_ok=True)
            (args.output / "comparison.md").write_text(compare(args.runs) + "\n")
            print((args.output / "comparison.md").read_text())
        else:
            drive(args)


def drive(args: argparse.Namespace) -> None:
    """Train and evaluate an agent, and keep both.

    Raises:
        ValueError: for numbers with which it would learn or show nothing.
    """
    if not args.minutes > 0 or args.episodes < 1 or args.steps < 1:
        raise ValueError(
            f"Needed are minutes > 0, episodes >= 1 and steps >= 1, got {args.minutes:g}, {args.episodes} and "
            f"{args.steps}."
        )
    torch.set_num_threads(1)
    objectives, directory = default_objectives(), args.output / args.what
    agent, record = train(args.what, 60 * args.minutes, objectives, args.seed)
    directory.mkdir(parents=True, exist_ok=True)
    torch.save(agent.policy.state_dict(), directory / "policy.pt")
    (directory / "training.json").write_text(json.dumps(record, indent=2))
    policy = Policy(agent, len(objectives))
    print(record, evaluate(policy, objectives, directory / "evaluation", args.episodes, args.steps), sep="\n")


if __name__ == "__main__":
    main()
