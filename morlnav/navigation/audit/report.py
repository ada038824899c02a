"""An audit of a learned reward, written into one directory."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from morlnav.navigation.audit.verdict import Audit
from morlnav.record.markdown import markdown_table

FACTS = {
    "target_reward": "mean reward of the target",
    "noise_correlation": "rank correlation of ε and mean reward",
    "return_spearman": "rank correlation of predicted and baseline return (Spearman)",
    "return_kendall": "the same (Kendall)",
    "mean_spearman": "rank correlation of mean reward and baseline return",
    "length_spearman": "rank correlation of mean reward and episode length",
    "pair_accuracy": "accuracy on pairs of snippets (no measure of a reward)",
    "calibration_error": "expected calibration error of pairs",
}
"""What the readable report lists, with its names there."""


def write_audit(audit: Audit, directory: str | Path, settings: Mapping[str, Any] | None = None) -> str:
    """Write tables and figures of an audit, and return the report that a person reads first.

    Files: ``behaviours.csv``, ``noise.csv``, ``calibration.csv``, ``plans.csv``, ``audit.json`` (settings, verdict,
    reasons and facts), ``audit.md``, ``margins.png``, ``noise.png`` and, if the audit planned, ``plans.png``.

    Args:
        audit: from :func:`~morlnav.navigation.audit.audit_reward`.
        directory: is made if it does not exist; files of an earlier audit in it are replaced.
        settings: what the audit was done with, for ``audit.json``.

    Returns:
        Markdown: the verdict with its reasons, and the tables.
    """
    from morlnav.navigation.audit.plots import plot_margins, plot_noise, plot_plans  # loads matplotlib

    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    for name in ("behaviours", "noise", "calibration", "plans"):
        getattr(audit, name).to_csv(directory / f"{name}.csv", index=False)
    verdict = {"settings": dict(settings or {}), **audit.summary()}
    (directory / "audit.json").write_text(json.dumps(verdict, indent=2) + "\n", encoding="utf-8")
    report = _report(audit)
    (directory / "audit.md").write_text(report + "\n", encoding="utf-8")
    plot_margins(audit.behaviours).savefig(directory / "margins.png", dpi=150)
    plot_noise(audit.noise, audit.calibration).savefig(directory / "noise.png", dpi=150)
    (directory / "plans.png").unlink(missing_ok=True)
    if audit.planned:
        radii = {"human_radius": audit.world.human_radius, "robot_radius": audit.world.robot.radius}
        plot_plans(audit.planned, audit.references, **radii).savefig(directory / "plans.png", dpi=150)
    return report


def _report(audit: Audit) -> str:
    lines = [f"**{'Passed' if audit.passed else 'Failed'}.**", *[f"- {reason}" for reason in audit.reasons], ""]
    behaviours = []
    for row in audit.behaviours.itertuples():
        interval = "–" if pd.isna(row.margin_low) else f"{row.margin_low:.0f} … {row.margin_high:.0f}"
        margin, required = ("–" if pd.isna(x) else f"{x:.0f}" for x in (row.margin, row.required))
        numbers = f"{row.score:.0f}", f"{row.mean_reward:.2f}", margin, interval, required, row.pairs
        behaviours.append((row.behaviour, *numbers))
    head = "behaviour", "return", "mean reward", "margin", "95 % interval", "required", "scenes"
    lines += [markdown_table(head, behaviours, (":--", "--:")), ""]
    noise = audit.noise[["epsilon", "mean_reward", "baseline"]].map("{:.2f}".format)
    lines.append(markdown_table(("ε", "mean reward", "baseline return (normalised)"), noise.to_numpy()))
    if len(audit.plans):
        head = "scene planned", "boxes", "ends", "Fréchet m", "min d_h m", "human on the", "earns", "target"
        plans = []
        for row in audit.plans.itertuples():
            side = "right" if row.human_on_right else "left"
            distances = f"{row.frechet:.2f}", f"{row.min_human_distance:.2f}"
            earned = f"{row.earned:.0f}", f"{row.target_earned:.0f}"
            plans.append((row.scene, row.boxes, row.outcome, *distances, side, *earned))
        lines += ["", markdown_table(head, plans, ("--:", "--:", ":--", "--:", "--:", ":--", "--:"))]
    lines += ["", *[f"- {text}: {audit.facts[name]:.2f}" for name, text in FACTS.items()]]
    return "\n".join(lines)
