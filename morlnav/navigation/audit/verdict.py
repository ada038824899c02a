"""Does a learned reward prefer the demonstration? Ranking accuracy does not tell; behaviours and a planner do."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from torch import Tensor

from morlnav.navigation.audit.behaviours import Behaviour, alternative_behaviours
from morlnav.navigation.audit.noise import judge_noise, noisy_rollouts
from morlnav.navigation.envs import Transition
from morlnav.navigation.evaluation.metrics import frechet_distance, winding
from morlnav.navigation.evaluation.planner import PathPlanner, PlannedPath
from morlnav.navigation.evaluation.possible import path_returns
from morlnav.navigation.evaluation.references import reference_paths, without_boxes
from morlnav.navigation.evaluation.rollout import Outcome, Rollouts, evaluation_scenes
from morlnav.navigation.evaluation.statistics import bootstrap_interval
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import Scene, TensorWorld, World, without_human
from morlnav.transforms import DemonstrationReward

Reward = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Thresholds:
    """What a reward must fulfil to pass an audit; margins are of ``Σ c_d·(R̂ + b_d)``, the target's less another's.

    Args:
        margin: the mean margin over every alternative exceeds this.
        clear_margin: the mean margin over those in ``clear`` exceeds this.
        clear: alternatives that differ so much that more is asked for.
        idle_margin: the mean margin over idling exceeds this.
        target_reward: mean ``R̂`` on the target's steps is at least this.
        noise_correlation: Spearman correlation of ``ε`` and mean ``R̂`` is at most this.
        frechet: the planner's optimum stays within this distance of the target's path, in metres.
        human_distance: by how many metres the planner's optimum may pass the human nearer and further than the target.
        alike: an alternative is the target itself, and not judged, if the median Fréchet distance of their paths is
            below this, in metres, and they take the same time to a tenth.
    """

    margin: float = 0.0
    clear_margin: float = 50.0
    clear: tuple[str, ...] = ("wrong side", "taut 1.0", "radius 2.5", "radius 0.6", "swerve 0.55")
    idle_margin: float = 500.0
    target_reward: float = 0.85
    noise_correlation: float = -0.8
    frechet: float = 0.45
    human_distance: tuple[float, float] = (0.2, 0.3)
    alike: float = 0.1


@dataclass(frozen=True)
class Audit:
    """What an audit found.

    Attributes:
        behaviours: a row per behaviour, the target first: ``behaviour``, ``score`` (mean ``Σ c_d·(R̂ + b_d)`` over its
            paired scenes), ``mean_reward`` (mean ``R̂`` per step), ``steps``, ``pairs`` (scenes compared in), ``margin``
            with its bootstrap interval ``margin_low`` and ``margin_high``, and ``required`` (NaN: not judged).
        noise: a row per noise level: ``epsilon``, ``mean_reward`` with ``mean_reward_low`` and ``mean_reward_high``,
            ``baseline`` (mean baseline return as a fraction of what the whole way to the goal pays) and ``steps``.
        calibration: a row per bin of the predicted probability that the first of two snippets has less noise:
            ``predicted``, ``empirical`` and ``pairs``.
        plans: a row per planned scene: ``scene``, ``boxes`` (their number), ``outcome``, ``frechet``,
            ``min_human_distance``, ``human_on_right`` and ``earned``, what the demonstration reward pays for the path
            at full speed; the last three also of the target (``target_…``).
        planned: the planned paths themselves, with the target's paths in ``references``.
        world: where it was judged.
        facts: ``target_rank``, ``target_reward``, ``idle_margin``, ``worst_margin``, and over noisy roll-outs
            ``noise_correlation``, ``return_spearman``, ``return_kendall`` (``Σ c_d·(R̂ + b_d)`` and true baseline
            return), ``mean_spearman`` (mean ``R̂`` and baseline return), ``length_spearman`` (mean ``R̂`` and episode
            length), ``pair_accuracy`` and ``calibration_error``.
        reasons: one sentence for each requirement that the reward fails.
    """

    behaviours: pd.DataFrame
    noise: pd.DataFrame
    calibration: pd.DataFrame
    plans: pd.DataFrame
    facts: dict[str, float]
    reasons: list[str]
    planned: list[PlannedPath] = field(repr=False)
    references: list[Tensor] = field(repr=False)
    world: World = field(repr=False)

    @property
    def passed(self) -> bool:
        """Whether the reward meets every requirement."""
        return not self.reasons

    def summary(self) -> dict[str, Any]:
        """Verdict, reasons and facts in JSON's types."""
        facts = {name: round(value, 4) if math.isfinite(value) else None for name, value in self.facts.items()}
        return {"passed": self.passed, "reasons": list(self.reasons), **facts}


def audit_reward(
    reward: Reward,
    *,
    scenes: Scene | None = None,
    oracle: Callable[[Tensor], Tensor] | None = None,
    alternatives: Mapping[str, Behaviour] | None = None,
    scale: float = 10.0,
    offset: float = -1.0,
    observe_human: bool = True,
    world: World | None = None,
    max_steps: int = 250,
    demonstrator: Callable[[Tensor], Tensor] | None = None,
    levels: Sequence[float] = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5),
    hold: int = 10,
    snippet: int = 5,
    temperature: float = 10.0,
    plans: int = 3,
    bare: bool = False,
    thresholds: Thresholds | None = None,
    seed: int = 0,
) -> Audit:
    """Compare the demonstration with everything that should earn less, and look for the reward's true optimum.

    Behaviours are compared scene by scene, where both reach the goal without a collision (idling and spinning: where
    the target does). An alternative that drives like the target is none. Then the demonstrator is rolled out under
    growing noise in the same scenes, and a :class:`PathPlanner` finds the path that the reward likes best in some
    scenes where the target arrives.

    Args:
        reward: maps observations ``[B, 34]`` and actions ``[B, 2]`` to ``R̂`` ``[B]`` in [0, 1].
        scenes: held out, batched ``[S]``; 100 evaluation scenes by default.
        oracle: the target, from observations ``[B, 34]`` to actions; the paper's oracle by default.
        alternatives: by name; :func:`alternative_behaviours` by default.
        scale: the factor ``c_d``.
        offset: ``b_d``, added to ``R̂``.
        observe_human: whether the reward sees the human's position (``-NH`` ablation; ``[B, 32]`` without).
        world: the engine; tensors by default.
        max_steps: time limit of an episode, for idling, noise and plans.
        demonstrator: what the noise is put on, such as the clone; the oracle by default.
        levels: noise levels ``ε``, ascending.
        hold: steps that a random action lasts.
        snippet: steps of the snippets that are compared.
        temperature: the logit of a pair is this times the difference of mean ``R̂``.
        plans: scenes to plan in; 0 to leave the planner out.
        bare: take the boxes out of every second planned scene; they may stand in the way of what the reward likes more.
        thresholds: what is asked for.
        seed: of noise, snippets and bootstrap.

    Raises:
        ValueError: if the target reaches the goal in no scene.
    """
    scenes = evaluation_scenes(100) if scenes is None else scenes
    world, thresholds = world or TensorWorld(), thresholds or Thresholds()
    oracle = CircumnavigationOracle() if oracle is None else oracle
    alternatives = alternative_behaviours(scenes, max_steps, world) if alternatives is None else alternatives
    rng = np.random.default_rng(seed)

    demo = DemonstrationReward(reward, scale, offset)

    def paid(transition: Transition) -> Tensor:
        observation = transition.observation
        return demo.reward(observation if observe_human else without_human(observation), transition.action)

    target = Behaviour(lambda observation, _: oracle(observation), 2 * max_steps)
    driven = {"target": target.drive(scenes, world=world, objectives={"demo": paid})}
    arrived = driven["target"].outcome[0] == Outcome.GOAL
    if not arrived.any():
        raise ValueError("The target reaches the goal in no scene; the audit needs other scenes, or another target.")
    suite = {"target": target, **alternatives}
    driven |= {name: one.drive(scenes, world=world, objectives={"demo": paid}) for name, one in alternatives.items()}
    behaviours = _compare(driven, suite, scale, offset, thresholds, rng)
    noisy = noisy_rollouts(demonstrator or oracle, scenes, levels, hold, world=world, max_steps=max_steps, seed=seed)
    noise, calibration, facts = judge_noise(
        noisy, demo, levels, snippet, temperature, observe_human=observe_human, seed=seed
    )

    chosen = arrived.nonzero().flatten()[:plans].tolist()
    planner = PathPlanner(scale, offset, world, observe_human, max_steps=max_steps)
    planned = [
        planner(reward, without_boxes(scenes[index]) if bare and turn % 2 else scenes[index])
        for turn, index in enumerate(chosen)
    ]
    references = reference_paths(scenes[chosen], oracle, world=world, max_steps=2 * max_steps) if chosen else []
    others = behaviours[behaviours["required"].notna()]
    facts = {
        "target_rank": 1 + int((others["margin"] < 0).sum()),
        "target_reward": float(behaviours["mean_reward"][0]),
        "worst_margin": float(others["margin"].min()),
        "idle_margin": float(others.set_index("behaviour")["margin"].get("idle", math.nan)),
        **facts,
    }
    table = _plan_table(
        chosen,
        planned,
        references,
        lambda path, scene: path_returns([path], scene.unsqueeze(0), {"demo": paid}, world).item(),
    )
    reasons = _reasons(others, facts, table, thresholds)
    return Audit(behaviours, noise, calibration, table, facts, reasons, planned, references, world)


def _compare(
    driven: Mapping[str, Rollouts],
    suite: Mapping[str, Behaviour],
    scale: float,
    offset: float,
    thresholds: Thresholds,
    rng: np.random.Generator,
) -> pd.DataFrame:
    """The frame ``behaviours`` of an :class:`Audit`."""
    score = {name: rollouts.reward[0, ..., 0].double().sum(-1).cpu() for name, rollouts in driven.items()}
    steps = {name: rollouts.steps[0].cpu() for name, rollouts in driven.items()}
    target = (driven["target"].outcome[0] == Outcome.GOAL).cpu()
    rows = []
    for name, rollouts in driven.items():
        paired = target & (rollouts.outcome[0].cpu() == Outcome.GOAL) if suite[name].arrives else target
        margin = (score["target"] - score[name])[paired].numpy()
        low, high = (math.nan, math.nan) if name == "target" else bootstrap_interval(margin, rng)
        per_step = score[name][paired] / (scale * steps[name][paired]) - offset
        alike = suite[name].arrives and _alike(rollouts, driven["target"], paired, thresholds.alike)
        rows.append(
            {
                "behaviour": name,
                "score": score[name][paired].mean().item(),
                "mean_reward": per_step.mean().item(),
                "steps": steps[name][paired].double().mean().item(),
                "pairs": int(paired.sum()),
                "margin": math.nan if name == "target" or not len(margin) else margin.mean(),
                "margin_low": low,
                "margin_high": high,
                "required": math.nan if alike else _required(name, thresholds),
            }
        )
    return pd.DataFrame(rows)


def _alike(rollouts: Rollouts, target: Rollouts, paired: Tensor, within: float) -> bool:
    """Whether both take the same paths to ``within`` metres in the same time, in the median of these scenes ``[S]``."""
    scenes = paired.nonzero().flatten().tolist()
    paths, targets = rollouts.path[0], target.path[0]
    apart = frechet_distance([paths[scene] for scene in scenes], [targets[scene] for scene in scenes]).median()
    longer = (rollouts.steps[0] / target.steps[0] - 1)[scenes].abs().median()
    return bool(apart < within and longer < 0.1)


def _required(name: str, thresholds: Thresholds) -> float:
    if name == "idle":
        return thresholds.idle_margin
    return thresholds.clear_margin if name in thresholds.clear else thresholds.margin


def _plan_table(
    chosen: Sequence[int],
    planned: Sequence[PlannedPath],
    references: Sequence[Tensor],
    earned: Callable[[Tensor, Scene], float],
) -> pd.DataFrame:
    """The frame ``plans`` of an :class:`Audit`."""
    targets = [(path, plan.scene.human.to(path)) for path, plan in zip(references, planned, strict=True)]
    columns = {
        "scene": list(chosen),
        "boxes": [plan.scene.boxes.shape[-2] for plan in planned],
        "outcome": [plan.outcome.name.lower() for plan in planned],
        "frechet": frechet_distance([plan.path for plan in planned], references).tolist() if planned else [],
        "min_human_distance": [plan.min_human_distance for plan in planned],
        "human_on_right": [plan.human_on_right for plan in planned],
        "target_min_human_distance": [(path - human).norm(dim=-1).min().item() for path, human in targets],
        "target_human_on_right": [winding(path, human).item() < 0 for path, human in targets],
        "earned": [earned(plan.path, plan.scene) for plan in planned],
        "target_earned": [earned(path, plan.scene) for path, plan in zip(references, planned, strict=True)],
    }
    return pd.DataFrame(columns)


def _reasons(others: pd.DataFrame, facts: Mapping[str, float], plans: pd.DataFrame, wanted: Thresholds) -> list[str]:
    """A sentence for every requirement that is not met; what could not be measured is not met."""
    reasons = []
    if facts["target_rank"] > 1:
        reasons.append(f"The target ranks {facts['target_rank']}. instead of first.")
    for row in others.itertuples():
        if not row.margin > row.required:
            reasons.append(
                f"The margin over '{row.behaviour}' is {row.margin:.0f}, it must exceed {row.required:.0f} "
                f"({row.pairs} scenes)."
            )
    if not facts["target_reward"] >= wanted.target_reward:
        reasons.append(
            f"The target's mean reward is {facts['target_reward']:.2f}, at least {wanted.target_reward} is needed."
        )
    if not facts["noise_correlation"] <= wanted.noise_correlation:
        reasons.append(
            f"The mean reward does not fall with noise: its rank correlation with ε is "
            f"{facts['noise_correlation']:.2f}, at most {wanted.noise_correlation} is needed."
        )
    nearer, further = wanted.human_distance
    for row in plans.itertuples():
        apart = row.min_human_distance - row.target_min_human_distance
        faults = {
            f"ends by {row.outcome}": row.outcome != "goal",
            f"is {row.frechet:.2f} m from the target's path": not row.frechet < wanted.frechet,
            "passes on the wrong side": row.human_on_right != row.target_human_on_right,
            f"passes the human at {row.min_human_distance:.2f} m": not -nearer <= apart <= further,
        }
        if any(faults.values()):
            found = ", ".join(fault for fault, holds in faults.items() if holds)
            reasons.append(f"The path that the reward likes best in scene {row.scene} {found}.")
    return reasons
