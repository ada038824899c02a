import math
from itertools import product

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from morlnav.navigation.envs import default_objectives
from morlnav.navigation.evaluation import best_utility, evaluate_policy, evaluation_scenes, exact_front, possible_table
from morlnav.navigation.evaluation.possible import FARTHEST, SLOWEST, describe_possible, path_returns
from morlnav.navigation.world import Scene, TensorWorld
from morlnav.navigation.world.geometry import distance_to_box


def grid_path(scene, keep, spacing=0.05, reach=3):
    """The shortest way on a grid whose nodes have 32 neighbours, by trying every node and every edge."""
    x, y = (np.arange(low, high, spacing) for low, high in ((-1.0, scene.goal[0] + 1.0), (-4.0, 4.0)))
    node = torch.from_numpy(np.stack(np.meshgrid(x, y, indexing="ij"), -1)).float()
    free = (node - scene.human).norm(dim=-1) >= keep
    free &= (distance_to_box(node.unsqueeze(2), scene.boxes) >= 0.18).all(-1)
    number = np.arange(free.numel()).reshape(free.shape)
    edges = []
    for dx, dy in product(range(-reach, reach + 1), repeat=2):
        if math.gcd(dx, dy) != 1 or dx < 0 or (dx == 0 and dy < 0):
            continue
        tail = (slice(0, len(x) - dx), slice(max(-dy, 0), len(y) - max(dy, 0)))
        head = (slice(dx, None), slice(max(dy, 0), len(y) - max(-dy, 0)))
        ok = (free[tail] & free[head]).numpy()
        edges.append((number[tail][ok], number[head][ok], np.full(ok.sum(), spacing * math.hypot(dx, dy))))
    tails, heads, lengths = map(np.concatenate, zip(*edges, strict=True))
    graph = coo_array((lengths, (tails, heads)), shape=(free.numel(),) * 2).tocsr()
    start = int(node.norm(dim=-1).argmin())
    length = dijkstra(graph, directed=False, indices=start).reshape(free.shape)
    return length[((node - scene.goal).norm(dim=-1) <= 0.35).numpy()].min()


def ahead(observation, preference):
    return torch.tensor([0.5, 0.0]).expand(len(observation), 2)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_front_is_what_a_grid_planner_finds(seed):
    scenes = evaluation_scenes(1, seed=seed)
    front = exact_front(scenes, steps=3)
    for kept, length in zip(front.distance.tolist(), front.length[0].tolist(), strict=True):
        found = grid_path(scenes[0], kept)
        # A grid of 32 directions makes a way longer by 1.3 % at most; blocked nodes cost or save a spacing at each end.
        assert length - 0.1 <= found <= 1.015 * length + 0.1


def test_a_front_costs_more_the_farther_it_keeps_away():
    front = exact_front(evaluation_scenes(5))
    assert front.distance[0] == pytest.approx(0.48)
    assert front.distance[-1] == FARTHEST
    assert (front.length.diff(dim=1) > -1e-9).all()
    for row, path in zip(front.length, front.paths, strict=True):
        assert torch.stack([line.diff(dim=0).norm(dim=-1).sum() for line in path]) == pytest.approx(row)
    table = front.table()
    assert len(table) == 5 * 9
    assert (table.query("distance < 0.481")["time_ratio"] == 1).all()


def test_who_drives_the_front_has_all_of_it_and_who_dawdles_has_less():
    front = exact_front(evaluation_scenes(20))
    distance = np.linspace(0.48, 2.0, 200)
    assert front.share(distance, front.at(distance)) > 0.99
    eleven = np.linspace(0.48, 2.0, 11)
    losses = [0.01, 0.02, 0.03]
    shares = [front.share(eleven, front.at(eleven) + loss) for loss in losses]
    assert shares == sorted(shares, reverse=True)
    assert front.excess(eleven, front.at(eleven) + 0.02) == pytest.approx(0.02)
    assert front.share(np.array([]), np.array([])) == 0
    assert front.share(np.array([1.0]), np.array([SLOWEST + 0.01])) == 0


def test_a_scene_where_a_distance_cannot_be_kept_is_left_out():
    scenes = evaluation_scenes(2)
    scenes.start[0, :2] = scenes.human[0] - torch.tensor([1.0, 0.0])
    front = exact_front(scenes)
    assert front.length[0].isinf().any()
    assert torch.equal(front.time_ratio, front.length[1] / front.length[1, 0])


def test_returns_along_a_path_are_what_the_environment_pays():
    scenes = evaluation_scenes(3)
    free = Scene(**{**scenes.to_tensordict(), "boxes": scenes.boxes[:, :0], "human": scenes.human + 50}, batch_size=[3])
    free.start[:, 2] = 0
    objectives = default_objectives()
    driven = evaluate_policy(ahead, free, torch.eye(2)[:1], objectives=objectives)
    lines = [torch.stack([torch.zeros(2), goal - torch.tensor([0.35, 0.0])]) for goal in free.goal]
    paid = path_returns(lines, free, objectives, TensorWorld())
    assert paid.numpy() == pytest.approx(driven.reward[0].sum(1).numpy(), abs=13)  # less than one step of progress


def test_the_best_known_path_is_the_one_that_the_preference_asks_for():
    scenes, objectives = evaluation_scenes(4), default_objectives()
    front = exact_front(scenes)
    preferences = torch.eye(2)
    best = best_utility(front, scenes, preferences, objectives)
    returns = [path_returns([paths[k] for paths in front.paths], scenes, objectives) for k in (0, -1)]
    assert best[1] == pytest.approx((returns[0][:, 0] + returns[0][:, 2]).mean().item())  # the shortest way
    assert best[0] == pytest.approx((returns[1][:, 0] + returns[1][:, 1]).mean().item())  # the widest way
    slow = path_returns([paths[0] for paths in front.paths], scenes, objectives, TensorWorld(step_time=0.4))
    assert slow[:, 2].mean() == pytest.approx(returns[0][:, 2].mean().item() / 2, rel=0.02)


def test_a_table_sets_a_policy_beside_what_is_possible():
    front = exact_front(evaluation_scenes(4))
    summary = pd.DataFrame(
        {
            "lambda_demo": [0.0, 0.0, 1.0],
            "lambda_distance": [1.0, 0.0, 0.0],
            "lambda_efficiency": [0.0, 1.0, 0.0],
            "min_human_distance": [1.5, 0.5, 1.0],
            "time_ratio": [1.1, 1.02, 1.3],
        }
    )
    table = possible_table(front, summary, pd.Series([1.0, 2.0, 3.0]), torch.tensor([2.0, 2.0, 2.0]))
    assert table["on_edge"].tolist() == [True, True, False]
    assert table["regret"].tolist() == [1.0, 0.0, -1.0]
    assert table["mean_excess"].nunique() == 1
    assert table["mean_excess"][0] == pytest.approx(table["excess"][:2].mean())
    assert "% of the exact front" in describe_possible(table)
