"""What ``balance`` makes of kept policies: how evenly a style follows its weight, without another training.

``python -m benchmarks.even_knob results/default results/three_styles/seed_*`` drives the evaluation's scenes and
preferences, and prints for each policy and balance of the demonstration what the knob then does.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from torch import Tensor

import morlnav
from morlnav.deployment import Policy
from morlnav.navigation.envs.rewards import Efficiency
from morlnav.navigation.evaluation import (
    episode_metrics,
    evaluate_policy,
    evaluation_scenes,
    fidelity,
    reference_paths,
    summarise,
)
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import Scene
from morlnav.record.markdown import markdown_table
from morlnav.simplex import preference_edges

STYLES = ("demo", "distance", "efficiency")


def measure(policy: Policy, scenes: Scene, references: list[Tensor], steps: int = 10) -> list[str]:
    """A row: success, the lower ρ of each style's two edges, and distances from λ = demo to λ = distance.

    Args:
        policy: for the three styles.
        scenes: to drive in, ``[S]``.
        references: the demonstrator's paths in these scenes.
        steps: of the weights along an edge.

    Raises:
        ValueError: for a policy of other styles.
    """
    if policy.objectives != STYLES:
        raise ValueError(f"The knob is that of {', '.join(STYLES)}; the policy weighs {', '.join(policy.objectives)}.")
    paid = dict.fromkeys(STYLES, Efficiency())  # which is no matter here
    rollouts = evaluate_policy(policy, scenes, preference_edges(len(STYLES), steps), objectives=paid)
    summary = summarise(frame := episode_metrics(rollouts, STYLES, references=references), resamples=2)
    ranks = fidelity(frame).groupby("objective")["edge_spearman"].min()
    edge = summary[np.isclose(summary["lambda_efficiency"], 0)].sort_values("lambda_distance")
    metres = ", ".join(edge["min_human_distance"].map("{:.2f}".format))
    return [f"{frame['success'].mean():.2%}", *(f"{ranks[name]:.2f}" for name in STYLES), metres]


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.even_knob", description=__doc__.split("\n", 1)[0])
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--demo", type=float, nargs="+", default=[1.0, 0.3], help="balances of the demonstration")
    parser.add_argument("--scenes", type=int, default=100)
    arguments = parser.parse_args()
    scenes, rows = evaluation_scenes(arguments.scenes, seed=12345), []
    references = reference_paths(scenes, CircumnavigationOracle(), max_steps=500)
    for run in arguments.runs:
        for demo in arguments.demo:
            policy = morlnav.load(run, balance={"demo": demo})
            rows.append([f"`{run}`", f"{demo:g}", *measure(policy, scenes, references)])
    head = ("run", "balance of demo", "success", *(f"ρ {name}" for name in STYLES), "distance, demo to distance")
    print(markdown_table(head, rows, (":--", "--:")))


if __name__ == "__main__":
    main()
