"""Panels that can be read: titles, numbers on every axis, and legends beside the data."""

from matplotlib.colors import to_hex

from benchmarks.plot import OTHERS, OURS, plot
from benchmarks.table import tabulate
from benchmarks.timing import Row


def growth(what, values, name="ours", **settings):
    return [Row("growth", f"{size} {what}", name, "1/s", [value], size=size, **settings) for size, value in values]


def two_lines():
    ours, peer = [(1, 1.0), (8, 2.0)], [(1, 2.0), (8, 1.0)]
    return [*growth("seeds", ours), *growth("seeds", peer, "peer", ours=False)]


def drawn(rows):
    figure = plot(tabulate(rows))
    figure.draw_without_rendering()
    return figure.axes


def test_what_grows_has_a_panel_and_a_title_of_its_own():
    panels = drawn([*growth("seeds", [(1, 1.0), (8, 2.0)]), *growth("boxes", [(1, 1.0), (8, 2.0)])])
    assert [axes.get_xlabel() for axes in panels] == ["seeds", "boxes"]
    assert [axes.get_title("left") for axes in panels] == ["growth: seeds, in 1/s", "growth: boxes, in 1/s"]


def test_every_axis_has_numbers_even_where_little_changes():
    for values in ([(2, 85.0), (16, 92.0)], [(1, 50.0), (8192, 400_000.0)]):
        (axes,) = drawn(growth("boxes", values))
        low, high = axes.get_ylim()
        shown = [
            tick for tick in axes.yaxis.get_major_ticks() if tick.label1.get_text() and low <= tick.get_loc() <= high
        ]
        assert len(shown) >= 2


def test_a_legend_covers_no_data():
    (axes,) = drawn(
        [*growth("seeds", [(1, 1.0), (8, 2.0)]), *growth("seeds", [(1, 2.0), (8, 1.0)], "peer", ours=False)]
    )
    assert axes.get_legend().get_window_extent().x0 >= axes.get_window_extent().x1


def test_ours_has_a_colour_that_no_other_has():
    rows = [Row("speed", "c", "morlnav", "1/s", [1.0]), Row("speed", "c", "peer", "1/s", [2.0], ours=False)]
    (axes,) = drawn(rows)
    assert [to_hex(bar.get_facecolor()) for bar in axes.patches] == [OURS[0], OTHERS[0]]
    (axes,) = drawn(
        [*growth("seeds", [(1, 1.0), (8, 2.0)]), *growth("seeds", [(1, 2.0), (8, 1.0)], "peer", ours=False)]
    )
    colours = {handle.get_label(): to_hex(handle[0].get_color()) for handle in axes.containers}
    assert colours["ours"] in OURS
    assert colours["peer"] in OTHERS
