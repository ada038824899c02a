"""``morlnav-clone STUDY``: how a clone of the demonstrator does under noise, or with fewer demonstrations."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from hydra import compose, initialize_config_dir
from matplotlib.figure import Figure
from omegaconf import DictConfig
from torch import Tensor

from morlnav.cli import conf_dir, one_sentence_errors, quiet, set_threads
from morlnav.navigation.audit import Behaviour
from morlnav.navigation.audit.noise import noisy_rollouts
from morlnav.navigation.envs import GoalProgress
from morlnav.navigation.evaluation import Outcome, Rollouts, evaluation_scenes
from morlnav.navigation.evaluation.statistics import _interval
from morlnav.navigation.record.plots import _tidy
from morlnav.navigation.world import Scene
from morlnav.record.colours import COLOURS, INK
from morlnav.trainers.builders import build
from morlnav.trainers.drex import make_demonstrations, train_clone
from morlnav.trainers.styles import on_whole_observations

LEVELS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
NUMBERS = (1, 3, 10, 30, 100, 300, 1000)


def study_noise(cfg: DictConfig, episodes: int = 20, levels: Sequence[float] = LEVELS, hold: int = 1) -> pd.DataFrame:
    """Normalised baseline return of the clone under ε-greedy noise (Fig. 2a).

    Args:
        cfg: as of ``morlnav-train``.
        episodes: held-out scenes, all of which the demonstrator drives without a collision.
        levels: noise levels ``ε``, ascending.
        hold: steps that a random action lasts; 1 as printed.

    Returns:
        A row per level: ``epsilon``, ``baseline`` (1 pays as much as the whole way to the goal) with its bootstrap
        interval ``baseline_low`` and ``baseline_high``, and the demonstrator's own return ``demonstrator``.
    """
    clone = _clone(cfg)
    scenes = _free_scenes(cfg, episodes)
    world = build(cfg.world, device="cpu")
    rollouts = noisy_rollouts(clone, scenes, levels, hold, world=world, max_steps=cfg.env.max_steps, seed=cfg.seed)
    returns = (rollouts["reward"][..., 0] * rollouts["mask"]).sum(-1)
    return _table("epsilon", levels, returns / _whole_way(scenes), cfg, scenes)


def study_number(cfg: DictConfig, episodes: int = 20, numbers: Sequence[int] = NUMBERS) -> pd.DataFrame:
    """Normalised baseline return of clones of few and many demonstrations ``N_D`` (Fig. 2b).

    Args:
        cfg: as of ``morlnav-train``.
        episodes: held-out scenes, all of which the demonstrator drives without a collision.
        numbers: of demonstrations.

    Returns:
        A row per number, as from :func:`study_noise`, with ``demonstrations`` in place of ``epsilon``.
    """
    scenes, returns = _free_scenes(cfg, episodes), []
    for number in numbers:
        cfg.demonstrations.num = number
        returns.append(_baseline(_clone(cfg), scenes, cfg))
    return _table("demonstrations", numbers, torch.stack(returns), cfg, scenes)


def _clone(cfg: DictConfig) -> Callable[[Tensor], Tensor]:
    return on_whole_observations(cfg, train_clone(cfg, make_demonstrations(cfg)))


def _demonstrator(cfg: DictConfig) -> Callable[[Tensor], Tensor]:
    if "policy" not in cfg.demonstrations:
        raise ValueError("morlnav-clone measures a clone against its demonstrator; recorded demonstrations have none.")
    return build(cfg.demonstrations.policy)


def _free_scenes(cfg: DictConfig, count: int) -> Scene:
    """Held-out scenes in which the demonstrator reaches the goal."""
    scenes = evaluation_scenes(4 * count, seed=cfg.evaluation.seed, sampler=build(cfg.env.scenes))
    free = (_drive(_demonstrator(cfg), scenes, cfg).outcome[0] == Outcome.GOAL).nonzero().flatten()[:count]
    if len(free) < count:
        raise ValueError(f"The demonstrator reaches the goal in only {len(free)} of {4 * count} scenes.")
    return scenes[free]


def _drive(policy: Callable[[Tensor], Tensor], scenes: Scene, cfg: DictConfig) -> Rollouts:
    behaviour = Behaviour(lambda observation, _: policy(observation), cfg.env.max_steps)
    return behaviour.drive(scenes, world=build(cfg.world, device="cpu"))


def _whole_way(scenes: Scene) -> Tensor:
    return GoalProgress().scale * (scenes.goal - scenes.start[:, :2]).norm(dim=-1)


def _baseline(policy: Callable[[Tensor], Tensor], scenes: Scene, cfg: DictConfig) -> Tensor:
    """Normalised baseline returns ``[S]``."""
    return _drive(policy, scenes, cfg).reward[0, ..., 0].sum(-1) / _whole_way(scenes)


def _table(name: str, values: Sequence[float], returns: Tensor, cfg: DictConfig, scenes: Scene) -> pd.DataFrame:
    rng, best = np.random.default_rng(cfg.seed), _baseline(_demonstrator(cfg), scenes, cfg).mean().item()
    rows = []
    for value, row in zip(values, returns.double().cpu().numpy(), strict=True):
        low, high = _interval(row, 0.95, 1000, rng)
        ends = {"baseline_low": low, "baseline_high": high, "demonstrator": best}
        rows.append({name: value, "baseline": row.mean(), **ends})
    return pd.DataFrame(rows)


def plot_study(table: pd.DataFrame) -> Figure:
    """A study's table as a figure in the style of Fig. 2.

    Examples:
        >>> row = {"epsilon": 0.0, "baseline": 0.9, "baseline_low": 0.8, "baseline_high": 1.0, "demonstrator": 0.95}
        >>> len(plot_study(pd.DataFrame([row])).axes)
        1
    """
    name = table.columns[0]
    figure = Figure(figsize=(4.4, 3.0), layout="constrained", facecolor="w")
    axes = figure.subplots()
    axes.axhline(table["demonstrator"][0], color=INK, lw=1, ls=(0, (1, 1.5)), label="demonstrator")
    axes.fill_between(
        table[name], table["baseline_low"], table["baseline_high"], color=COLOURS["demo"], alpha=0.2, lw=0
    )
    axes.plot(table[name], table["baseline"], "o-", color=COLOURS["demo"], ms=4, label="clone")
    label = {"epsilon": "noise ε", "demonstrations": "demonstrations"}[name]
    axes.set(xlabel=label, ylabel="normalised baseline return", xscale="log" if name == "demonstrations" else "linear")
    axes.legend(frameon=False, fontsize=8)
    _tidy(axes)
    return figure


def main() -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-clone", description=__doc__.split(": ", 1)[1])
    parser.add_argument("study", choices=["noise", "number"], help="Fig. 2a: over ε; Fig. 2b: over demonstrations")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="as of morlnav-train")
    parser.add_argument("--episodes", type=int, default=20, help="held-out scenes (default: 20)")
    parser.add_argument("--hold", type=int, default=1, help="noise: steps that a random action lasts (default: 1)")
    parser.add_argument("--output", type=Path, default=Path("outputs/clone"), help="default: outputs/clone")
    args = parser.parse_intermixed_args()
    with one_sentence_errors():
        with initialize_config_dir(conf_dir(), version_base="1.3"):
            cfg = compose("train", args.overrides)
        set_threads(cfg.threads)
        if args.study == "noise":
            table = study_noise(cfg, args.episodes, hold=args.hold)
        else:
            table = study_number(cfg, args.episodes)
        args.output.mkdir(parents=True, exist_ok=True)
        table.to_csv(args.output / f"{args.study}.csv", index=False)
        plot_study(table).savefig(args.output / f"{args.study}.png", dpi=150)
        print(table.round(3).to_string(index=False))
        print(f"Table and figure are in {args.output}")


if __name__ == "__main__":
    main()
