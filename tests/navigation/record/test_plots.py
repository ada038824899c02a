import io

import numpy as np
import pytest
import torch
from matplotlib.patches import Circle, Rectangle

from morlnav.data import preference_edges
from morlnav.navigation.envs import Efficiency, default_objectives
from morlnav.navigation.evaluation import (
    compare_extremes,
    episode_metrics,
    evaluate_policy,
    evaluation_scenes,
    overall,
    summarise,
)
from morlnav.navigation.record.plots import edge_order, plot_metrics, plot_trajectories
from morlnav.record.colours import blend

NAMES = ("demo", "distance", "efficiency")


def drive(observation, preference):
    return torch.stack([0.3 + 0.2 * preference[:, -1], observation[:, 1] + preference[:, 1]], -1)


@pytest.fixture(scope="module")
def rollouts():
    terms = {"demo": Efficiency(-1.0), **default_objectives()}
    terms = {name: terms[name] for name in ("baseline", *NAMES)}
    return evaluate_policy(drive, evaluation_scenes(3), preference_edges(3, 4), objectives=terms, max_steps=15)


@pytest.fixture(scope="module")
def frame(rollouts):
    return episode_metrics(rollouts, ("baseline", *NAMES))


def lines_of(axes):
    return [line for line in axes.lines if len(line.get_xdata()) > 1]


def test_every_edge_shows_its_trajectories_in_every_scene(rollouts):
    figure = plot_trajectories(rollouts, NAMES, [0, 2])
    assert len(figure.axes) == 3 * 2
    for axes in figure.axes:
        assert axes.get_aspect() == 1
        assert len(lines_of(axes)) == 5
        assert sum(isinstance(patch, Rectangle) for patch in axes.patches) == 3
        assert sum(isinstance(patch, Circle) for patch in axes.patches) == 2


def test_boxes_are_drawn_where_they_stand(rollouts):
    axes = plot_trajectories(rollouts, NAMES, [1]).axes[0]
    patch = next(patch for patch in axes.patches if isinstance(patch, Rectangle))
    x, y, length, width, angle = rollouts.scene.boxes[0, 1, 0].tolist()
    corners = patch.get_corners()
    offsets = np.array([[-length, -width], [length, -width], [length, width], [-length, width]])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    assert np.allclose(corners, offsets @ turn + [x, y], atol=1e-5)


def test_references_are_drawn_too(rollouts):
    references = [torch.tensor([[0.0, 0.0], [5.0, 1.0]])] * 3
    axes = plot_trajectories(rollouts, NAMES, [0], references=references).axes[0]
    assert any(np.allclose(line.get_xdata(), [0, 5]) for line in lines_of(axes))


def test_metrics_have_a_panel_each_and_a_strip(frame):
    summary = summarise(frame, resamples=50)
    metrics = ["navigation_time", "frechet", "min_human_distance"]
    tests = compare_extremes(frame, ["min_human_distance"])
    figure = plot_metrics(summary, tests, metrics, baseline=overall(frame, resamples=50))
    assert len(figure.axes) == 2 + 1  # there is no Fréchet distance without references
    labels = [label.get_text() for label in figure.axes[-1].get_xticklabels()]
    assert labels == ["efficiency", "distance", "demo", "efficiency"]
    shown = {text.get_text() for text in figure.axes[1].texts}
    assert shown <= {"***", "**", "*", "ns"}
    assert len(figure.axes[1].texts) == 3
    figure.savefig(io.BytesIO(), format="png", dpi=40)


def test_preferences_off_the_edge_are_left_out_and_the_rest_sorted():
    preferences = np.array([[0.0, 1.0, 0.0], [0.4, 0.3, 0.3], [1.0, 0.0, 0.0], [0.7, 0.3, 0.0], [0.0, 0.0, 1.0]])
    assert edge_order(preferences, (0, 1)).tolist() == [2, 3, 0]


def test_corners_have_the_objectives_own_colours():
    assert np.allclose(blend(np.eye(2), ["#ff8000", "#0000ff"]), [[1, 128 / 255, 0], [0, 0, 1]])


def test_wrong_arguments_are_explained(rollouts, frame):
    with pytest.raises(ValueError, match="3 entries"):
        plot_trajectories(rollouts, ("distance", "efficiency"))
    with pytest.raises(ValueError, match="below 3"):
        plot_trajectories(rollouts, NAMES, [3])
    with pytest.raises(ValueError, match="one of the metrics"):
        plot_metrics(summarise(frame, resamples=50), metrics=["comfort"])
