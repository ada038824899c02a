import io

import numpy as np
import pytest
import torch

from morlnav.evaluation import front_table
from morlnav.evaluation.front_plot import plot_front

PREFERENCES = torch.tensor([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])


def test_two_objectives_show_every_point_and_the_line_of_the_best():
    points = torch.tensor([[4.0, 1.0], [1.0, 1.0], [2.0, 3.0]])
    (axes,) = plot_front(front_table(PREFERENCES, points, ["speed", "comfort"])).axes
    np.testing.assert_allclose(axes.collections[0].get_offsets(), points)
    np.testing.assert_allclose(axes.lines[0].get_xydata(), [[2, 3], [4, 1]])
    assert axes.get_xlabel() == "return: speed"


@pytest.mark.parametrize(("num_objectives", "panels"), [(3, 3), (4, 6), (5, 10)])
def test_more_objectives_have_a_panel_per_pair(num_objectives, panels):
    names = [f"o{index}" for index in range(num_objectives)]
    returns = torch.randn(num_objectives, 6, num_objectives)
    figure = plot_front(front_table(torch.eye(num_objectives), returns, names))
    assert len(figure.axes) == panels
    figure.savefig(io.BytesIO(), format="png", dpi=40)


def test_static_objectives_are_no_panels():
    table = front_table(PREFERENCES, torch.randn(3, 3), ["baseline", "speed", "comfort"])
    assert len(plot_front(table).axes) == 1


def test_a_single_objective_is_no_front():
    with pytest.raises(ValueError, match="two objectives"):
        plot_front(front_table(torch.ones(2, 1), torch.randn(2, 1), ["speed"]))
