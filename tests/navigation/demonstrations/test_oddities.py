"""Odd files, one row each: what they are, and either that they are read rightly or what is asked about them."""

import codecs
import io
import json
import pickle

import numpy as np
import pandas as pd
import pytest
from drives import SAID, SCENE, TRUTH, assert_true, drive, read, refused, write

from morlnav.navigation.demonstrations import Reading

TIME, HALF = TRUTH["time"].to_numpy(), TRUTH["heading"] / 2
CSV = TRUTH.to_csv(index=False)
LINES = CSV.splitlines()
MOMENTS = pd.to_datetime(1_730_000_000_000_000_000 + (TIME * 1e9).round().astype("int64"))
PLACES = [name for name in TRUTH if name not in ("time", "heading")]
ARRAYS = {name: TRUTH[name].to_numpy() for name in TRUTH}
POSE = {"pose": TRUTH[["x", "y", "heading"]].to_numpy(), "time": TIME,
        "goal": np.array([[6.0, 0.0]]), "human": np.array([[3.0, 0.0]])}  # fmt: skip
QUATERNION = {"qx": 0 * HALF, "qy": 0 * HALF, "qz": np.sin(HALF), "qw": np.cos(HALF)}
NO_HEADING = TRUTH.drop(columns="heading")
ROWS = TRUTH.to_dict("records")
ACTIONS = pd.DataFrame({"time": 0.2 * np.arange(30), "v": 0.4, "omega": 0.0, "start_x": 0.0, "start_y": 0.0,
                        "start_heading": 0.0, "goal_x": 2.0, "goal_y": 0.0, "human_x": 1, "human_y": 1})  # fmt: skip


def clock(times):
    """Times of day."""
    return [f"{int(t) // 3600 % 24:02d}:{int(t) // 60 % 60:02d}:{t % 60:06.3f}" for t in times]


def turned(angle, frame=TRUTH, shift=(0.0, 0.0)):
    cos, sin = np.cos(angle), np.sin(angle)
    parts = {"heading": frame["heading"] + angle}
    for name in ("", "goal_", "human_"):
        x, y = frame[f"{name}x"], frame[f"{name}y"]
        parts |= {f"{name}x": cos * x - sin * y + shift[0], f"{name}y": sin * x + cos * y + shift[1]}
    return frame.assign(**parts)


def scaled(factor, unit):
    return TRUTH.assign(**TRUTH[PLACES] * factor).rename(columns={name: f"{name} ({unit})" for name in PLACES})


def store(content, tmp_path, name="drive"):
    """A file of whatever is given: a table, arrays, a text or bytes."""
    file = tmp_path / name
    if isinstance(content, pd.DataFrame):
        content.to_csv(file, index=False)
    elif isinstance(content, dict):
        np.savez(file := tmp_path / f"{name}.npz", **content)
    else:
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return file


BOX = {"box1_x": 3.0, "box1_y": 3.0, "box1_half_length": 0.5, "box1_half_width": 0.3, "box1_angle": 0.0}


def boxed(**parts):
    return TRUTH.assign(**BOX | parts)


def npz(**arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


RIGHT = {
    "dates with a comma, as Python's logging writes": TRUTH.assign(
        time=[moment.strftime("%Y-%m-%d %H:%M:%S,%f") for moment in MOMENTS]
    ).to_csv(index=False, sep=";"),
    "dates with a zone": TRUTH.assign(time=[moment.strftime("%Y-%m-%dT%H:%M:%S.%f+02:00") for moment in MOMENTS]),
    "German dates": TRUTH.assign(time=[moment.strftime("%d.%m.%Y %H:%M:%S.%f") for moment in MOMENTS]),
    "American dates": TRUTH.assign(time=[moment.strftime("%m/%d/%Y %I:%M:%S.%f %p") for moment in MOMENTS]),
    "times of day": TRUTH.assign(time=clock(TIME + 5000)),
    "minutes and seconds": TRUTH.assign(time=[f"{int(t + 50) // 60}:{(t + 50) % 60:06.3f}" for t in TIME]),
    "times before zero": TRUTH.assign(time=TIME - 100),
    "headings beyond a turn": TRUTH.assign(heading=TRUTH["heading"] + 4 * np.pi),
    "headings from 0 to 2π": TRUTH.assign(heading=TRUTH["heading"] % (2 * np.pi)),
    "quaternions that change their sign": NO_HEADING.assign(
        **{name: part * np.where(TIME > 6, -1, 1) for name, part in QUATERNION.items()}
    ),
    "quaternions of length 1.01": NO_HEADING.assign(**{name: 1.01 * part for name, part in QUATERNION.items()}),
    "roll, pitch, yaw": TRUTH.rename(columns={"heading": "yaw"}).assign(roll=0.01, pitch=-0.02),
    "UTM": turned(0.0, shift=(691234.5, 5334567.25)).rename(columns={"x": "easting", "y": "northing"}),
    "inches": scaled(1 / 0.0254, "in"),
    "a row of units": f"{LINES[0]}\ns,m,m,rad,m,m,m,m\n" + "\n".join(LINES[1:]),
    "a row of other units": f"{LINES[0]}\n[ms],[cm],[cm],[deg],[cm],[cm],[cm],[cm]\n"
    + TRUTH.assign(**TRUTH[PLACES] * 100, time=1000 * TIME, heading=np.degrees(TRUTH["heading"])).to_csv(
        index=False, header=False
    ),
    "lines above the header": f"Robot: one\nDate: 2024-05-01\n\n{CSV}",
    "lines above the header with fields": f"NO_OF_FRAMES\t144\nNAMES\ta\tb\n{CSV.replace(',', chr(9))}",
    "hours with a unit": TRUTH.assign(time=TIME / 3600).rename(columns={"time": "time [h]"}),
    "quotients of units": TRUTH.rename(columns={"time": "t / s", "x": "x / m", "y": "y / m", "heading": "phi / rad"}),
    "rows between bars": "\n".join(f"|{line.replace(',', '|')}|" for line in LINES),
    "two columns of episodes": TRUTH.assign(session=1, trial="b"),
    "UTF-16 without a mark": CSV.encode("utf-16-le"),
    "UTF-16, large end first, without a mark": CSV.encode("utf-16-be"),
    "UTF-32": CSV.encode("utf-32"),
    "a mark, semicolons, commas and CRLF": codecs.BOM_UTF8
    + TRUTH.to_csv(index=False, sep=";", decimal=",").replace("\n", "\r\n").encode(),
    "minus signs of a typesetter": CSV.replace("-", "\u2212"),
    "spaces that do not break": CSV.replace(",", ",\u00a0"),
    "the end of a text of DOS": CSV.encode() + b"\x1a",
    "a text with separators in quotes": TRUTH.assign(note='turn, "left"').to_csv(index=False, quoting=2),
    "columns by two spaces": TRUTH.to_string(index=False),
    "rows without a pose": CSV.replace(LINES[7], ",".join([LINES[7].split(",")[0], *["nan"] * 3, *["6,0,3,0"]])),
    "JSON, a list of rows": json.dumps(ROWS, indent=1),
    "JSON, columns": json.dumps(TRUTH.to_dict("list")),
    "JSON, a row in each line": "\n".join(map(json.dumps, ROWS)),
    "scene in the first row": TRUTH.assign(**{name: [value] + [None] * 143 for name, value in SCENE.items()}),
    "a human who is hidden at times": TRUTH.assign(human_x=np.where((TIME > 4) & (TIME < 8), np.nan, 3.0)),
    "arrays [N, 1]": {name: value[:, None] for name, value in ARRAYS.items()},
    "a record array": {"data": TRUTH.to_records(index=False)},
    "arrays of texts": {name: value.astype(str) for name, value in ARRAYS.items()},
    "arrays of bytes": {name: value.astype("S") for name, value in ARRAYS.items()},
    "arrays, large end first": {name: value.astype(">f8") for name, value in ARRAYS.items()},
    "an array of dates": ARRAYS | {"time": (TIME * 1e9).astype("int64").astype("datetime64[ns]")},
    "an array of durations": ARRAYS | {"time": (TIME * 1e6).astype("int64").astype("timedelta64[us]")},
    "goal and human in every row": POSE | {name: np.tile(POSE[name], (144, 1)) for name in ("goal", "human")},
    "an array of names of episodes": ARRAYS | {"episode": np.array(["hall"] * 144)},
}


@pytest.mark.parametrize("name", RIGHT)
def test_it_is_read_rightly(name, tmp_path, recwarn):
    file = read(store(RIGHT[name], tmp_path))
    assert_true(file)
    assert not [each for each in recwarn if issubclass(each.category, (UserWarning, RuntimeWarning))]
    if "above" in name:
        assert file.notes == ["2 lines above the header"]


def at(row, **values):
    """One row of the drive, spoilt."""
    frame = TRUTH.copy().astype(object)
    frame.loc[row, list(values)] = list(values.values())
    return frame


ASKED = {
    "whole seconds": (TRUTH.assign(time=np.floor(TIME)), "row 3, column time", "are times rounded"),
    "one time for all": (TRUTH.assign(time=5.0), "row 3, column time", "are times rounded"),
    "single precision since 1970": (ARRAYS | {"time": (TIME + 1.73e9).astype(np.float32)}, "in single precision"),
    "the last row first": (TRUTH.iloc[::-1], "are the rows out of order?"),
    "midnight": (TRUTH.assign(time=clock(TIME + 86395)), "do times of day pass midnight?"),
    "a blank among dates": (at(5, time="").assign(time=lambda f: f["time"].where(f["time"] == "", MOMENTS.astype(str))),
                            "row 7, column time: expected a time, got ''"),
    "quaternions of zeros": (NO_HEADING.assign(qx=0, qy=0, qz=0, qw=0), "expected a quaternion of length 1"),
    "a heading that never changes": (NO_HEADING.assign(qx=0, qy=0, qz=0, qw=1), "it never changes", "--heading motion"),
    "a camera's quaternion": (NO_HEADING.assign(qx=0, qy=np.sin(HALF), qz=0, qw=np.cos(HALF)), "would lean by 0."),
    "degrees of latitude": (
        TRUTH.assign(x=11 + TRUTH["x"] / 7e4, y=48 + TRUTH["y"] / 1.1e5), "degrees of latitude and longitude?"
    ),
    "columns lat and lon": (NO_HEADING.rename(columns={"x": "lon", "y": "lat"}), "have to become metres first"),
    "kilometres": (TRUTH.assign(**TRUTH[PLACES] / 1000), "are lengths in kilometres?", "--units length=km"),
    "hours": (TRUTH.assign(time=TIME / 3600), "is time in hours? Then: --units time=h."),
    "days, as spreadsheets count": (TRUTH.assign(time=45000 + TIME / 86400), "is time in days? Then: --units time=d."),
    "hundredths of a second": (TRUTH.assign(time=100 * TIME), "in hundredths of a second? Then: --units time=cs."),
    "feet": (TRUTH.assign(**TRUTH[PLACES] / 0.3048), "for a faster one, or --units if lengths or times are in others"),
    "inches": (TRUTH.assign(**TRUTH[PLACES] / 0.0254), "or inches? Then: --units length=cm or length=in."),
    "decimetres": (TRUTH.assign(**TRUTH[PLACES] * 10), "are lengths in decimetres? Then: --units length=dm."),
    "metres that are called millimetres": (
        TRUTH.rename(columns={"x": "x_mm", "y": "y_mm"}), "are lengths in metres? Then: --units length=m."
    ),
    "seconds that are called milliseconds": (
        TRUTH.rename(columns={"time": "time_ms"}), "is time_ms in seconds? Then: --units time=s."
    ),
    "numbers of rows for times": (
        TRUTH.iloc[::2].assign(time=range(72)), "is time their number? Then: --columns frame=time --rate NUMBER; if not"
    ),
    "numbers of rows of 25 Hz": (TRUTH.assign(time=range(144)), "rows lie 1 s apart; is time their number?"),
    "a box's sides in centimetres": (
        boxed(box1_half_length=80.0, box1_half_width=60.0), "column box1_half_length", "is it in centimetres?",
        "Then: --units box1_half_length=cm; if not: --units box1_half_length=m."
    ),
    "a box's sides in millimetres": (boxed(box1_half_width=300.0), "column box1_half_width", "is it in millimetres?"),
    "a box's sides in kilometres": (boxed(box1_half_length=0.0005), "got 0.0005; is it in kilometres?"),
    "a box's whole sides in centimetres": (
        TRUTH.assign(box1_x=3.0, box1_y=3.0, box1_angle=0.0, box1_length=90.0, box1_width=0.4), "column box1_length"
    ),
    "a box by its corners": (
        TRUTH.assign(box1_x_min=2, box1_x_max=3, box1_y_min=2, box1_y_max=3), "box1_x_min, box1_x_max", "tell of a box"
    ),
    "a wall by its ends": (TRUTH.assign(wall1_x1=2, wall1_y1=3, wall1_x2=4, wall1_y2=3), "wall1_x1, ", "tell of a box"),
    "coordinates of 1e300": (TRUTH.assign(goal_x=1e300), "is it in another frame than the robot?"),
    "rows 3 s apart": (TRUTH.iloc[::30], "rows lie 3 s apart", "--max-gap 3"),
    "two rows": (TRUTH.iloc[[0, -1]], "expected at most 2 s; allow it with --max-gap 15"),
    "an infinite goal": (TRUTH.assign(goal_x=np.inf), "row 2, column goal_x: expected a finite number, got inf"),
    "an infinite human": (at(9, human_y=-np.inf), "row 11, column human_y: expected a finite number, got -inf"),
    "no human at all": (TRUTH.assign(human_x=None, human_y=None), "got nothing; give it by --human X Y"),
    "no goal at all": (TRUTH.assign(goal_x=None, goal_y=None), "got nothing; give it by --goal X Y or --goal end"),
    "a goal seen from the robot": (
        TRUTH.assign(goal_x=6 - TRUTH["x"], goal_y=-TRUTH["y"]), "got 5.91; is it told from the robot"
    ),
    "a human seen once elsewhere": (at(50, human_x=9.0), "row 52, column human_x: expected 3 as before"),
    "a human who walks in few rows": (
        TRUTH.iloc[::18].assign(human_x=lambda frame: 3 - 0.1 * frame["time"]), "the human walks by 1.3 m"
    ),
    "a step between rows": (NO_HEADING.drop(columns="time").assign(dt=0.1), "does dt say how far", "--rate 10"),
    "a rate in an array": ({name: value for name, value in POSE.items() if name != "time"} | {"fps": np.array(10.0)},
                           "does fps say how far rows are apart? Then: --rate 10"),
    "a cell that does not end": (at(5, x="9" * 5000), f"row 7, column x: expected a number, got '{'9' * 60}…'"),
    "yes and no": (ARRAYS | {"x": ARRAYS["x"] > 1}, "row 0 of the arrays, column x: expected a number, got 'False'"),
    "yes and no in JSON": (
        json.dumps(TRUTH.assign(heading=True).to_dict("list")), "column heading: expected a number, got 'True'"
    ),
    "complex numbers": (ARRAYS | {"x": ARRAYS["x"] + 0j}, "column x: expected a finite number, got 0j"),
    "arrays on their side": (POSE | {"pose": POSE["pose"].T}, "expected the shape"),
    "a table in an array": (ARRAYS | {"x": np.zeros((144, 2))}, "array x: expected the shape [144], got [144, 2]"),
    "half an archive": (npz(**ARRAYS)[:3000], "is no .npz file of numbers"),
    "zeros after a power cut": (CSV.encode() + bytes(512), "ends in zero bytes"),
    "two objects of JSON": ('{"a": 1}\n{"b"', "row 2 is no line of JSON"),
    "JSON columns of two lengths": (json.dumps({"x": [1, 2], "y": [1]}), "columns of one length, got x 2, y 1"),
    "old Excel": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600), "a spreadsheet of old Excel"),
    "MATLAB": (b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(100), "a MATLAB file"),
    "a pickle": (pickle.dumps(TRUTH), "a pickle, which could run anything"),
    "Feather": (b"ARROW1\0\0" + bytes(50), "an Arrow or Feather file"),
    "Git LFS": (b"version https://git-lfs.github.com/spec/v1\noid sha256:abc\n", "git lfs pull"),
    "a page in place of a file": (b"<!DOCTYPE html>\n<html>Sign in</html>\n", "a web page"),
    "actions in milliseconds": (ACTIONS.assign(time=1000 * ACTIONS["time"]), "rows lie 200 s apart; is time in milli"),
    "a text in one line": (json.dumps({"data": {"x": [1, 2], "y": [1, 2]}}), "data.x: expected a number, got '[1, 2]'"),
    "lists in the cells of JSON": (
        json.dumps([{"x": [row["x"]], "y": row["y"]} for row in ROWS]), "column x: expected a number, got '[0.0]'"
    ),
    "actions with a gap": (ACTIONS.assign(time=ACTIONS["time"] + 5 * (ACTIONS.index > 10)), "is told for 5.2 s"),
}  # fmt: skip


@pytest.mark.parametrize("name", ASKED)
def test_it_is_asked_about(name, tmp_path, recwarn):
    content, *words = ASKED[name]
    refused(store(content, tmp_path), *words)
    assert not [each for each in recwarn if issubclass(each.category, (UserWarning, RuntimeWarning))]


def test_a_localisation_that_jumps_between_control_steps_is_named(tmp_path):
    for row in (50, 51):
        y = TRUTH["y"] + 3 * (TRUTH.index == row)
        refused(write(TRUTH.assign(y=y), tmp_path), f"row {row + 2}", how=drive)
    refused(tmp_path / "drive.csv", "3.00 m off the drive before and after it; does the localisation jump", how=drive)
    drive(tmp_path / "drive.csv", tolerance=3.1)


def test_standing_before_the_drive_is_told(tmp_path):
    before = TRUTH.loc[[0] * 100].assign(time=0.1 * np.arange(100) - 10)
    drive(write(pd.concat([before, TRUTH]), tmp_path))
    assert "the robot stands for up to 10.0 s before it moves" in SAID[0]


def test_of_many_bad_episodes_ten_have_reasons_and_all_are_named(tmp_path):
    many = pd.concat([TRUTH.iloc[::2].assign(episode=i, goal_x=6.0 if i == 0 else 30.0 + i) for i in range(14)])
    refused(write(many, tmp_path), "13 of 14 episodes cannot be taken", "episode 10: column goal_x", how=drive)
    refused(tmp_path / "drive.csv", "and episodes 11, 12, 13; --good-only takes the other 1.", how=drive)
    assert len(drive(tmp_path / "drive.csv", good_only=True)["episode"].unique()) == 1


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan, np.inf])
def test_a_tolerance_is_positive(tolerance, tmp_path):
    with pytest.raises(ValueError, match="tolerance must be positive"):
        drive(write(TRUTH, tmp_path), tolerance=tolerance)


def test_a_file_is_read_once(tmp_path):
    (tmp_path / "again.csv").symlink_to(write(TRUTH, tmp_path))
    with pytest.raises(ValueError, match=r"again.csv is named twice"):
        drive([tmp_path / "drive.csv", tmp_path / "again.csv"])


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"separator": ""}, "separator must be one sign, got ''"),
        ({"separator": "::"}, "separator must be one sign"),
        ({"goal": (np.nan, 0)}, "goal must be two finite numbers"),
        ({"human": (0, np.inf)}, "human must be two finite numbers"),
    ],
)
def test_readings_that_make_no_sense(settings, words):
    with pytest.raises(ValueError, match=words):
        Reading(**settings)


def test_what_was_asked_is_answered(tmp_path):
    rows = write(TRUTH.iloc[::2].assign(time=range(72)), tmp_path, "rows.csv")
    assert_true(read(rows, Reading(columns={"frame": "time"}, rate=5.0)))
    assert np.ptp(read(rows, Reading(units={"time": "s"})).time) == 71
    inches = write(TRUTH.assign(**TRUTH[PLACES] / 0.0254), tmp_path, "inches.csv")
    assert_true(read(inches, Reading(units={"length": "in"})))
    sides = write(boxed(box1_half_length=80.0, box1_half_width=60.0), tmp_path, "sides.csv")
    units = {"box1_half_length": "cm", "box1_half_width": "cm"}
    assert read(sides, Reading(units=units)).scene["boxes"][0, 0, 2:4] == pytest.approx([0.8, 0.6])


def test_what_is_measured_of_obstacles_is_no_box(tmp_path):
    file = read(write(TRUTH.assign(obstacle_dist=2, box_color=1, obstacle_count=3, wall=0), tmp_path))
    assert file.ignored == ["obstacle_dist", "box_color", "obstacle_count", "wall"]


@pytest.mark.parametrize("text", ["[" * 100_000, '{"x": 1}\n' + "[" * 100_000, "3", "null", "[[1, 2], [3, 4]]", "{}"])
def test_json_that_holds_no_rows_is_refused_in_one_sentence(text, tmp_path):
    refused(store(text, tmp_path, "drive.json"), "drive.json")


@pytest.mark.parametrize(("unit", "factor"), [("cm/s", 100), ("mm/s", 1000), ("km/h", 3.6), ("deg/s", 57.3)])
def test_actions_in_other_units_are_asked_for_and_read(unit, factor, tmp_path):
    name = "omega" if unit == "deg/s" else "v"
    actions = ACTIONS.assign(omega=0.2 * (-1) ** ACTIONS.index)
    file = write(actions.assign(**{name: factor * actions[name]}), tmp_path)
    refused(file, f"column {name}", f"is it in {unit}? Then: --units {name}={unit}", how=drive)
    again = drive(file, Reading(units={name: unit}))["action"][:5]
    assert again == pytest.approx(actions[["v", "omega"]].to_numpy()[:5], abs=1e-3)


def test_a_link_to_itself_is_no_file(tmp_path):
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    with pytest.raises(FileNotFoundError, match=r"There is no file .*loop.csv"):
        drive([write(TRUTH, tmp_path), tmp_path / "loop.csv"])


def test_a_hundred_thousand_columns_are_listed_at_once(tmp_path):
    names = [f"c{i}" for i in range(100_000)]
    refused(store(",".join(names) + "\n" + ",".join("1" * len(names)), tmp_path), "c48, c49 and 99950 more; say which")


def test_one_column_is_not_two_things(tmp_path):
    refused(write(TRUTH, tmp_path), "column x is given for y, and", reading=Reading(columns={"x": "x", "y": "x"}))
