"""The front of any multi-objective policy: mean returns per preference, their quality, and what it is measured from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd
import torch
from torch import Tensor

from morlnav.evaluation.pareto import Scalarisation, expected_utility, hypervolume, pareto_mask, utility


def reference_from_bounds(bounds: Tensor, max_steps: int) -> Tensor:
    """A reference point ``[m]`` for the hypervolume: one step worse than the worst return that an episode can have.

    An episode may end at any time, so the worst return (with a discount of 1) is that of ``max_steps`` of the least
    reward, or 0 where rewards are not negative; there the point is -1.

    Args:
        bounds: least and largest reward of a step, ``[2, m]``, as ``NavigationEnv.reward_bounds``.
        max_steps: an episode's time limit.

    Returns:
        The point; minus infinity where a reward has no least value, for which the caller must choose one.

    Examples:
        >>> bounds = torch.tensor([[-10.0, 0.0, -torch.inf], [0.0, 1.0, torch.inf]])
        >>> reference_from_bounds(bounds, max_steps=250).tolist()
        [-2510.0, -1.0, -inf]
    """
    worst = bounds[0].clamp_max(0) * (max_steps + 1)
    return torch.where(worst < 0, worst, -1.0)


def read_reference(
    given: Sequence[float] | Mapping[str, float] | None, rewards: Sequence[str], default: Tensor
) -> Tensor:
    """A reference point ``[m]`` as a config names it: all entries, some by name, or none.

    Args:
        given: one number per entry, or numbers by name.
        rewards: names of all ``m`` entries.
        default: ``[m]``, of the entries that are not given.

    Raises:
        ValueError: for another number of entries, or a name that no entry has.

    Examples:
        >>> read_reference({"comfort": -50.0}, ["speed", "comfort"], torch.tensor([-10.0, -torch.inf]))
        tensor([-10., -50.])
    """
    if given is None:
        return default
    values = given
    if isinstance(given, Mapping):
        unknown = [name for name in given if name not in rewards]
        if unknown:
            raise ValueError(f"reference names {unknown[0]}; the objectives are: {', '.join(rewards)}.")
        values = [given.get(name, value) for name, value in zip(rewards, default.tolist(), strict=True)]
    numbers = isinstance(values, Sequence) and all(isinstance(value, (int, float)) for value in values)
    if not numbers or len(values) != len(rewards):
        raise ValueError(
            f"reference needs {len(rewards)} numbers, for {', '.join(rewards)}, or numbers by name; got {given}."
        )
    return default.new_tensor(values)


def front_table(
    preferences: Tensor,
    returns: Tensor,
    rewards: Sequence[str],
    reference: Tensor | None = None,
    scalarisation: Scalarisation | None = None,
) -> pd.DataFrame:
    """The front of mean return vectors of a policy on any task, one row per preference.

    Args:
        preferences: λ, ``[P, n]``.
        returns: ``[P, E, m]`` of ``E`` episodes per preference, or their means ``[P, m]``; larger is better.
        rewards: names of all ``m`` entries of the reward; the last ``n`` are those that λ weighs.
        reference: reference point of the hypervolume ``[m]``; without one there is no hypervolume.
        scalarisation: gives the weights of the utility, such as a loss's; ``(1, …, 1, λ)`` if ``None``.

    Returns:
        Columns ``lambda_<name>``, ``return_<name>`` (means), ``std_<name>`` (of the returns, if episodes are given),
        ``utility`` ``= wᵀR``, ``non_dominated``, and, the same in every row, ``hypervolume``, ``reference_<name>`` and
        ``expected_utility`` of the whole front.

    Raises:
        ValueError: if the shapes, the names or the reference point do not fit, or a number is not finite.

    Examples:
        >>> returns = torch.tensor([[4.0, 1.0], [1.0, 4.0], [1.0, 1.0]])
        >>> table = front_table(torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]]), returns, ["speed", "comfort"],
        ...     reference=torch.zeros(2))
        >>> table[["utility", "non_dominated", "hypervolume"]].values.tolist()
        [[4.0, True, 7.0], [4.0, True, 7.0], [1.0, False, 7.0]]
    """
    preferences, returns = preferences.detach().cpu(), returns.detach().cpu().double()
    means = returns.mean(1) if returns.dim() == 3 else returns
    quality = expected_utility(means, preferences, scalarisation)  # checks the shapes
    if len(rewards) != means.shape[1]:
        raise ValueError(f"The rewards have {means.shape[1]} entries, but {len(rewards)} are named.")
    tuneable = rewards[len(rewards) - preferences.shape[1] :]
    columns = {f"lambda_{name}": preferences[:, i].double().round(decimals=6) for i, name in enumerate(tuneable)}
    columns |= {f"return_{name}": means[:, i] for i, name in enumerate(rewards)}
    if returns.dim() == 3 and returns.shape[1] > 1:
        columns |= {f"std_{name}": returns[..., i].std(1) for i, name in enumerate(rewards)}
    columns |= {"utility": utility(means, preferences.double(), scalarisation), "non_dominated": pareto_mask(means)}
    table = pd.DataFrame({name: value.numpy() for name, value in columns.items()})
    if reference is None:
        table["hypervolume"] = float("nan")
    else:
        table["hypervolume"] = hypervolume(means, reference.cpu())
        table[[f"reference_{name}" for name in rewards]] = reference.tolist()
    table["expected_utility"] = quality
    return table


def describe_front(table: pd.DataFrame) -> str:
    """One or two sentences on the quality of a :func:`front_table`.

    >>> points = torch.tensor([[2.0, 1.0], [-1.0, 3.0]])
    >>> print(describe_front(front_table(torch.eye(2), points, ["speed", "comfort"], torch.zeros(2))))
    Expected utility 2.5, hypervolume 2 above the reference point (speed 0, comfort 0).
    1 of 2 points lies below the reference point and adds nothing.
    """
    names = [name.removeprefix("reference_") for name in table if name.startswith("reference_")]
    first = table.iloc[0]
    if not names:
        return (
            f"Expected utility {first['expected_utility']:.1f}. "
            "No hypervolume: some rewards have no known least value; give evaluation.reference, a number for each."
        )
    point = ", ".join(f"{name} {first[f'reference_{name}']:.6g}" for name in names)
    text = (
        f"Expected utility {first['expected_utility']:.1f}, hypervolume {first['hypervolume']:.4g} above the "
        f"reference point ({point})."
    )
    exceeds = pd.concat([table[f"return_{name}"] > table[f"reference_{name}"] for name in names], axis=1).all(axis=1)
    below = int((~exceeds).sum())
    verbs = "lies below the reference point and adds" if below == 1 else "lie below the reference point and add"
    return f"{text}\n{below} of {len(table)} points {verbs} nothing." if below else text
