import io
import json

import pandas as pd
import pytest
from rich.console import Console

from morlnav.navigation.evaluation import overall, summarise
from morlnav.navigation.evaluation.tables import audit_line, print_summary


def episodes(*corners):
    names = list(corners[0])
    rows = [
        {"preference": index, "scene": scene} | {f"lambda_{name}": corner[name] for name in names}
        for index, corner in enumerate(corners)
        for scene in range(2)
    ]
    metrics = {"success": True, "collision_human": False, "collision_box": False, "timeout": False}
    values = {"navigation_time": 17.25, "time_ratio": 1.1, "spl": 0.9, "min_human_distance": 1.0}
    values |= {"min_obstacle_distance": 0.5, "frechet": 0.3, "frechet_wide_left": 0.7, "frechet_free": 0.2}
    return pd.DataFrame(rows).assign(**metrics, **values, human_on_right=1.0, personal_space=0.7)


def printed(frame, width=80, **settings):
    file = io.StringIO()
    console = Console(file=file, width=width)
    print_summary(summarise(frame, resamples=2), overall(frame, resamples=2), console=console, **settings)
    return file.getvalue()


EDGE = [{"distance": w / 4, "efficiency": 1 - w / 4} for w in range(5)]


def test_corners_and_all_rows_fit_a_terminal():
    text = printed(episodes(*EDGE), demonstrated=["demo"])
    first = [line.split()[0] for line in text.splitlines() if line.strip()]
    assert first == ["all", first[1], "distance", "efficiency", "all"]
    assert "all 5" in text
    assert max(map(len, text.splitlines())) <= 80
    assert "17.2" in text


@pytest.mark.parametrize("width", [30, 60, 80, 200])
def test_columns_that_have_no_room_are_left_out_and_none_is_cut(width):
    text = printed(episodes(*EDGE), width, demonstrated=["demo"])
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    assert ("SPL" in text) == (width == 200)


def test_distances_to_a_demonstration_that_nobody_chose_are_not_shown():
    assert "Fréchet" not in printed(episodes(*EDGE), 200)
    assert "on right" not in printed(episodes(*EDGE), 200)
    own = printed(episodes(*EDGE), 200, demonstrated=["wide_left"])
    assert "Fréchet wide_left m" in own
    assert "Fréchet m" not in own


def test_without_corners_every_preference_is_shown():
    assert "0.25, 0.75" in printed(episodes(EDGE[1], EDGE[2]))


def test_a_run_without_an_audit_says_nothing_and_one_with_says_how_it_ended(tmp_path):
    assert audit_line(tmp_path, "demo") == ""
    (tmp_path / "audit.json").write_text(json.dumps({"passed": True, "reasons": []}))
    assert audit_line(tmp_path, "demo") == "Audit of demo: passed."
