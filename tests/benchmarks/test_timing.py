"""Contenders take turns; those that cannot run say why."""

import pytest

from benchmarks.timing import Contender, Effort, NotAvailable, race

EFFORT = Effort(rounds=3, seconds=0)


def test_contenders_take_turns_in_every_round():
    turns = []

    def build(name):
        return lambda: lambda: turns.append(name)

    rows = race("g", "c", "calls/s", [Contender(name, build(name)) for name in "ab"], EFFORT)
    assert [len(row.values) for row in rows] == [3, 3]
    assert "".join(turns) == "aabb" + 3 * "ab"  # each warms up twice


def test_a_missing_package_is_reported_as_missing_and_never_as_zero():
    def build():
        import a_package_that_nobody_has  # noqa: F401

    (row,) = race("g", "c", "calls/s", [Contender("peer", build)], EFFORT)
    assert row.values == []
    assert row.note == "missing: No module named 'a_package_that_nobody_has'"


def test_a_contender_may_say_why_it_does_not_run():
    def build():
        raise NotAvailable("not measured: seconds per step")

    (row,) = race("g", "c", "calls/s", [Contender("peer", build)], EFFORT)
    assert (row.values, row.note) == ([], "not measured: seconds per step")


def test_a_quick_try_leaves_peers_out():
    contenders = [Contender("ours", lambda: lambda: None), Contender("peer", lambda: lambda: None, peer=True)]
    rows = race("g", "c", "calls/s", contenders, Effort(rounds=1, seconds=0, quick=True))
    assert [row.name for row in rows] == ["ours"]


def test_rates_count_the_work_of_a_call():
    import time

    contenders = [Contender(str(work), lambda: lambda: time.sleep(0.002), work) for work in (1, 100)]
    one, hundred = race("g", "c", "naps/s", contenders, Effort(rounds=10, seconds=0.01))
    assert max(one.values) < 500  # a busy machine makes single rounds slower
    assert max(hundred.values) / max(one.values) == pytest.approx(100, rel=0.8)
