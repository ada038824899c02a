"""A drive counts once, however often it is told."""

import sys

import numpy as np
import pandas as pd
import pytest
import torch
from drives import SAID, TRUTH, bump, drive, refused, write

from morlnav.commands import record
from morlnav.navigation.demonstrations import (
    export_demonstrations,
    import_demonstrations,
    load_demonstrations,
    record_demonstrations,
    recorded_demonstrations,
    save_demonstrations,
)
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import SceneSampler

MIRRORED = TRUTH.assign(y=-TRUTH["y"], heading=-TRUTH["heading"])
DRIVEN, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 3, num_envs=4)


def same(name, tmp_path):
    """The drive of ``drive.csv`` in another file."""
    if name.endswith(".npz"):
        np.savez(tmp_path / name, **{column: TRUTH[column].to_numpy() for column in TRUTH})
        return tmp_path / name
    how = {"semicolons.csv": {"sep": ";", "decimal": ","}, "rounded.csv": {"float_format": "%.4f"}}
    changed = {
        "later.csv": TRUTH.assign(time=TRUTH["time"] + 1.7e9),
        "elsewhere.csv": TRUTH.assign(episode="hall"),
        "every second row.csv": TRUTH.iloc[::2],
        "moved columns.csv": TRUTH[list(TRUTH)[::-1]],
        "millimetres.csv": TRUTH.assign(**1000 * TRUTH[["x", "y"]]).rename(columns={"x": "x_mm", "y": "y_mm"}),
        "faster sensor.csv": bump(rate=50.0),
    }
    return write(changed.get(name, TRUTH), tmp_path, name, **how.get(name, {}))


NAMES = ["copy.csv", "arrays.npz", "semicolons.csv", "rounded.csv", "later.csv", "elsewhere.csv",
         "every second row.csv", "moved columns.csv", "millimetres.csv", "faster sensor.csv"]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_of_two_files_with_one_drive_the_second_is_refused(name, tmp_path):
    files = [write(TRUTH, tmp_path), same(name, tmp_path)]
    refused(files[1], f"is one of {files[0]} again, the same drive and scene", how=lambda *_: drive(files))


def morlnav_record(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["morlnav-record", *map(str, words)])
    record.main()


@pytest.mark.parametrize("name", NAMES)
def test_of_two_commands_with_one_drive_the_second_is_refused(name, tmp_path, monkeypatch):
    mine = tmp_path / "mine"
    morlnav_record(monkeypatch, mine, "--import", write(TRUTH, tmp_path))
    held = load_demonstrations(mine)
    for more in ([], ["--good-only"]):
        with pytest.raises(SystemExit, match="mine already holds all 1 episodes, the same drives in the same scenes"):
            morlnav_record(monkeypatch, mine, "--import", same(name, tmp_path), *more)
    assert (load_demonstrations(mine) == held).all()


def test_of_a_file_that_has_grown_the_new_drives_are_taken(tmp_path, monkeypatch, capsys):
    mine, file = tmp_path / "mine", write(TRUTH.assign(episode=0), tmp_path)
    morlnav_record(monkeypatch, mine, "--import", file)
    write(pd.concat([TRUTH.assign(episode=0), MIRRORED.assign(episode=1)]), tmp_path)
    with pytest.raises(SystemExit, match=r"mine already holds 1 of 2 episodes, .*; --good-only adds the others"):
        morlnav_record(monkeypatch, mine, "--import", file)
    morlnav_record(monkeypatch, mine, "--import", file, "--good-only")
    assert f"1 episode left out, held by {mine} already" in capsys.readouterr().out
    data = load_demonstrations(mine)
    sides = [data["pose"][data["episode"] == number, 1].sum().sign().item() for number in (0, 1)]
    assert sides == [1, -1]


def test_a_robot_that_drives_the_same_way_again_is_no_copy(tmp_path, monkeypatch):
    parts = [TRUTH.assign(episode="a"), MIRRORED.assign(episode="b"), TRUTH.assign(episode="c")]
    file = write(pd.concat(parts), tmp_path)
    assert drive(file)["episode"].unique().tolist() == [0, 1, 2]
    assert "1 episode drives as others of them do" in SAID[0]
    morlnav_record(monkeypatch, tmp_path / "mine", "--import", file)
    assert load_demonstrations(tmp_path / "mine")["episode"].max() == 2


def test_another_goal_or_human_or_box_makes_another_drive(tmp_path):
    box = {"box1_x": 3, "box1_y": 3, "box1_half_length": 0.5, "box1_half_width": 0.5, "box1_angle": 0}
    others = [TRUTH, TRUTH.assign(goal_x=6.01), TRUTH.assign(human_y=-0.1), TRUTH.assign(**box)]
    files = [write(frame, tmp_path, f"{i}.csv") for i, frame in enumerate(others)]
    assert drive(files)["episode"].unique().tolist() == [0, 1, 2, 3]


def test_a_data_set_of_minari_counts_once(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    from morlnav.navigation.demonstrations import to_minari

    to_minari(DRIVEN, "navigation/mine-v0")
    assert minari.list_local_datasets()
    export_demonstrations(DRIVEN, tmp_path / "drives.csv")
    word, mine = "minari:navigation/mine-v0", tmp_path / "mine"
    for files in ([word, word], [word, tmp_path / "drives.csv"]):
        with pytest.raises(SystemExit, match=r"3 of 6 episodes are there twice, .*; --good-only adds the others"):
            morlnav_record(monkeypatch, mine, "--import", *files)
    assert not mine.exists()
    morlnav_record(monkeypatch, mine, "--import", word)
    with pytest.raises(SystemExit, match="already holds all 3 episodes"):
        morlnav_record(monkeypatch, mine, "--import", tmp_path / "drives.csv")


def test_two_folders_with_one_drive_do_not_train_together(tmp_path):
    save_demonstrations(DRIVEN, tmp_path / "a")
    save_demonstrations(DRIVEN[DRIVEN["episode"] > 1], tmp_path / "b")
    for folders, count in ((["a", "b"], 1), (["a", "a"], 3)):
        with pytest.raises(ValueError, match=f"hold {count} drives twice; name each folder once"):
            recorded_demonstrations([tmp_path / folder for folder in folders])


def test_a_recording_that_goes_out_and_comes_in_again_is_known(tmp_path):
    export_demonstrations(DRIVEN, tmp_path / "drives.csv")
    assert torch.allclose(import_demonstrations(tmp_path / "drives.csv")["pose"], DRIVEN["pose"], atol=1e-3)
