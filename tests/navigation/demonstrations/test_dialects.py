"""Files as people have them: read as they are meant, or refused in one sentence that asks what is meant."""

import bz2
import gzip
import json
import lzma

import numpy as np
import pandas as pd
import pytest
import torch
from drives import SAID, SCENE, TRUTH, assert_true, bump, drive, read, refused, write

from morlnav.navigation.demonstrations import Reading, import_demonstrations


@pytest.mark.parametrize(
    "names",
    [
        {"time": "timestamp"},
        {"time": "t"},
        {"time": "stamp"},
        {"time": "Time (s)", "x": "X [m]", "y": "Y [m]", "heading": "Heading [rad]"},
        {"time": "%time", "x": "field.pose.pose.position.x", "y": "field.pose.pose.position.y", "heading": "yaw"},
        {"time": "__time", "x": "/odom/pose/pose/position/x", "y": "/odom/pose/pose/position/y"},
        {"x": "pos_x", "y": "pos_y", "heading": "theta", "goal_x": "target_x", "goal_y": "target_y"},
        {"x": "RobotX", "y": "RobotY", "heading": "RobotTheta", "human_x": "person_x", "human_y": "person_y"},
        {"time": "elapsed_s", "x": "x_m", "y": "y_m", "heading": "yaw_rad", "human_x": "ped1_x", "human_y": "ped1_y"},
        {name: f'"{name}"' for name in ("time", "x")},
        {name: f" {name} " for name in ("time", "x", "goal_y")},
        {name: name.upper() for name in ("time", "x", "y", "heading", "goal_x", "human_y")},
    ],
)
def test_usual_names_are_known(names, tmp_path):
    file = read(write(TRUTH.rename(columns=names), tmp_path))
    assert_true(file)
    assert len(file.used) == 8
    assert not file.ignored


def test_names_of_ones_own_are_told(tmp_path):
    file = write(TRUTH.rename(columns={"time": "zeitpunkt", "x": "rechts", "heading": "kurs"}), tmp_path)
    refused(file, "expected columns x, y, heading", "zeitpunkt, rechts, y, kurs", "--columns x=NAME")
    assert_true(read(file, Reading(columns={"time": "zeitpunkt", "x": "rechts", "heading": "kurs"})))
    refused(file, "no column foo that could be x", "rechts", reading=Reading(columns={"x": "foo"}))


def test_a_time_under_a_name_that_nobody_knows_is_asked_for(tmp_path):
    file = write(TRUTH.rename(columns={"time": "zeitpunkt"}), tmp_path)
    refused(file, "which column tells the time, is it zeitpunkt?", "--columns time=zeitpunkt")
    assert_true(read(write(TRUTH.drop(columns="time"), tmp_path), Reading(rate=10)))
    file = write(TRUTH.assign(time=np.arange(len(TRUTH))).rename(columns={"time": "frame"}), tmp_path)
    refused(file, "numbers in column frame", "--rate")
    assert_true(read(file, Reading(rate=10)))


def test_nothing_is_ignored_without_a_word(tmp_path):
    drive(write(TRUTH.assign(battery=0.9, note="fine", v=3.0, omega=1.0), tmp_path))
    assert SAID[0].endswith(
        "read time, x, y, heading, goal_x, goal_y, human_x, human_y; ignored battery, note, v, omega."
    )
    assert (
        "144 rows, 1 episode of 14.3 s at 10 Hz, 0.45 m/s on average and 0.45 at most; followed within 0.00" in SAID[0]
    )


@pytest.mark.parametrize(
    ("separator", "decimal"), [(";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", "."), (" ", ".")]
)
def test_separators_and_decimal_signs_are_seen(separator, decimal, tmp_path):
    assert_true(read(write(TRUTH, tmp_path, sep=separator, decimal=decimal)))


def test_quoted_decimal_commas_are_seen_and_bare_ones_between_commas_are_refused(tmp_path):
    assert_true(read(write(TRUTH, tmp_path, decimal=",", quoting=2)))
    lines = write(TRUTH[["time", "x", "y"]].assign(h=0.5), tmp_path, sep=";", decimal=",").read_text().replace(";", ",")
    (tmp_path / "bare.csv").write_text(lines)
    refused(tmp_path / "bare.csv", "row 2: expected 4 fields as in the header, got 8", "decimal commas?")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252", "latin-1"])
def test_encodings_and_byte_order_marks_do_not_matter(encoding, tmp_path):
    frame = TRUTH.assign(heading=np.degrees(TRUTH["heading"])).rename(
        columns={"heading": "Gier [°]", "time": "Zeit [s]"}
    )
    file = tmp_path / "drive.csv"
    file.write_bytes(frame.rename(columns={"Gier [°]": "yaw [°]"}).to_csv(index=False).encode(encoding))
    assert_true(read(file))


@pytest.mark.parametrize("ending", ["\r\n", "\r", "\n"])
def test_comments_blank_lines_and_line_ends_do_not_matter(ending, tmp_path):
    lines = write(TRUTH, tmp_path).read_text().splitlines()
    lines = ["# recorded in the hall", "", *lines[:3], "", "# pause", ",,,,,,,", *lines[3:], "", ""]
    (tmp_path / "drive.csv").write_bytes(ending.join(lines).encode())
    file = read(tmp_path / "drive.csv")
    assert_true(file)
    assert file.notes == ["2 lines of comment"]
    lines[10] = lines[10].replace(",6.0", ",oops")
    (tmp_path / "drive.csv").write_bytes(ending.join(lines).encode())
    refused(tmp_path / "drive.csv", "row 11, column goal_x: expected a number, got 'oops'")


@pytest.mark.parametrize("header", [True, False])
def test_a_separator_at_the_end_of_every_row(header, tmp_path):
    first, *rest = write(TRUTH, tmp_path).read_text().splitlines()
    (tmp_path / "drive.csv").write_text("\n".join([first + "," * header, *(f"{line}," for line in rest)]))
    assert_true(read(tmp_path / "drive.csv"))


def test_rows_of_another_length_are_named(tmp_path):
    lines = write(TRUTH, tmp_path).read_text().splitlines()
    (tmp_path / "cut.csv").write_text("\n".join(lines)[:-30])
    refused(tmp_path / "cut.csv", "row 145: expected 8 fields as in the header, got", "cut off")
    (tmp_path / "names.csv").write_text("\n".join([lines[0], *(f"{i},{line}" for i, line in enumerate(lines[1:]))]))
    refused(tmp_path / "names.csv", "row 2: expected 8 fields as in the header, got 9", "index without a name")


def test_an_index_column_is_left_out(tmp_path):
    file = read(write(TRUTH, tmp_path, index=True))
    assert_true(file)
    assert file.ignored == ["column 1"]
    assert_true(read(write(TRUTH.reset_index().rename(columns={"index": "Unnamed: 0"}), tmp_path)))


def test_headers_of_numpy_and_texts_without_one(tmp_path):
    np.savetxt(tmp_path / "drive.txt", TRUTH.to_numpy(), header=" ".join(TRUTH.columns))
    assert_true(read(tmp_path / "drive.txt"))
    np.savetxt(tmp_path / "bare.txt", TRUTH.to_numpy())
    refused(tmp_path / "bare.txt", "row 1: expected the names of the columns, got numbers", "--names")
    assert_true(read(tmp_path / "bare.txt", Reading(names=list(TRUTH.columns))))
    (tmp_path / "excel.csv").write_text("sep=;\n" + TRUTH.to_csv(index=False, sep=";"))
    assert_true(read(tmp_path / "excel.csv"))


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress])
def test_compressed_files_are_unpacked_whatever_they_are_called(pack, tmp_path):
    for name in ("drive.csv.packed", "drive.csv"):
        (tmp_path / name).write_bytes(pack(TRUTH.to_csv(index=False).encode()))
        assert_true(read(tmp_path / name))
    (tmp_path / "drive.csv.gz").write_bytes(pack(TRUTH.to_csv(index=False).encode())[:-300])
    refused(tmp_path / "drive.csv.gz", "damaged")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "holds no sample: it is empty (0 bytes)"),
        (b"  \n\n", "holds no sample: it is empty"),
        (b"time,x,y\n", "holds no sample"),
        (b"# nothing\n# at all\n", "holds no sample"),
        (b"\x93NUMPY\x01\x00v\x00", "a single NumPy array"),
        (b"PAR1\x15\x04", "a Parquet file"),
        (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
        (b"PK\x03\x04\x14\x00", "a zip archive without arrays, as spreadsheets are"),
        (b"SQLite format 3\x00", "the storage of a ROS 2 bag"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "is no text"),
        (b"just some words\nand more\n", "row 2: expected 3 fields as in the header, got 2"),
        (b"<html><body>404</body></html>\n<p>\n", "expected columns x, y"),
        (b"x,x,y\n1,2,3\n", "two columns are called x"),
        (b'x,y\n"1,2\n3,4\n', "no table"),
        (b'{"a": 1\n', "no line of JSON"),
    ],
)
@pytest.mark.parametrize("name", ["drive.csv", "drive.npz", "drive.txt"])
def test_files_of_another_kind_are_named(content, words, name, tmp_path):
    (tmp_path / name).write_bytes(content)
    refused(tmp_path / name, words)


def test_folders_are_told_what_they_are(tmp_path):
    for name, file, words in [
        ("bag", None, "a folder, and neither a ROS 2 bag nor demonstrations"),
        ("demos", "demonstrations.json", "a folder of demonstrations already"),
        ("lerobot", "meta/info.json", "a LeRobot data set"),
    ]:
        (tmp_path / name / "meta").mkdir(parents=True)
        if file:
            (tmp_path / name / file).write_text("{}")
        refused(tmp_path / name, words)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_times_in_other_units_are_asked_for(factor, unit, tmp_path):
    frame = TRUTH.assign(time=(TRUTH["time"] * factor).round().astype("int64"))
    word = {"ms": "milli", "us": "micro", "ns": "nano"}[unit]
    refused(write(frame, tmp_path), f"is time in {word}seconds?", f"--units time={unit}")
    assert_true(read(tmp_path / "drive.csv", Reading(units={"time": unit})))
    for name in (f"time [{unit}]", f"stamp_{unit}", f"Timestamp ({unit})"):
        assert_true(read(write(frame.rename(columns={"time": name}), tmp_path)))


def test_stamps_since_1970_keep_their_digits(tmp_path):
    stamp = 1_730_000_000_000_000_000 + (TRUTH["time"] * 1e9).round().astype("int64")
    assert_true(read(write(TRUTH.assign(time=stamp).rename(columns={"time": "stamp_ns"}), tmp_path)))
    parts = TRUTH.drop(columns="time").assign(secs=stamp // 10**9, nsecs=stamp % 10**9)
    assert_true(read(write(parts, tmp_path)))
    parts = parts.rename(columns={"secs": "header.stamp.sec", "nsecs": "header.stamp.nanosec"})
    assert_true(read(write(parts, tmp_path)))
    assert_true(read(write(TRUTH.assign(time=TRUTH["time"] + 1.73e9), tmp_path)))
    for form in ("%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%fZ", "%H:%M:%S.%f"):
        dates = pd.to_datetime(stamp).dt.strftime(form)
        assert_true(read(write(TRUTH.assign(time=dates), tmp_path)))


@pytest.mark.parametrize(("factor", "unit", "word"), [(1e3, "mm", "millimetres"), (1e2, "cm", "centimetres")])
def test_lengths_in_other_units_are_asked_for(factor, unit, word, tmp_path):
    lengths = [name for name in TRUTH if name not in ("time", "heading")]
    frame = TRUTH.assign(**TRUTH[lengths] * factor)
    refused(write(frame, tmp_path), f"are lengths in {word}?", f"--units length={unit}")
    assert_true(read(tmp_path / "drive.csv", Reading(units={"length": unit})))
    assert_true(read(write(frame.rename(columns={name: f"{name} [{unit}]" for name in lengths}), tmp_path)))
    both = frame.assign(time=TRUTH["time"] * 1000)
    refused(
        write(both, tmp_path), "is time in milliseconds?", f"are lengths in {word}?", f"--units time=ms length={unit}"
    )
    for thing in ("goal", "human"):
        one = TRUTH.assign(**{f"{thing}_{part}": SCENE[f"{thing}_{part}"] * factor for part in "xy"})
        refused(
            write(one, tmp_path),
            f"column {thing}_x",
            f"is it in {word}? Then: --units {thing}_x={unit} {thing}_y={unit}.",
        )


@pytest.mark.parametrize("name", ["yaw_deg", "heading (deg)", "theta [°]", "Yaw [degrees]"])
def test_degrees_in_a_name_are_understood(name, tmp_path):
    frame = TRUTH.assign(heading=np.degrees(TRUTH["heading"]) % 360)
    assert_true(read(write(frame.rename(columns={"heading": name}), tmp_path)))


@pytest.mark.parametrize("prefix", ["q", "orientation_", "pose.orientation."])
def test_quaternions_become_headings(prefix, tmp_path):
    half, names = TRUTH["heading"] / 2, [prefix + part for part in "xyzw"]
    parts = dict(zip(names, (0.0, 0.0, np.sin(half), np.cos(half)), strict=True))
    frame = TRUTH.drop(columns="heading").assign(**parts)
    assert_true(read(write(frame, tmp_path)))
    order = [*frame.columns[:-4], *frame.columns[-1:], *frame.columns[-4:-1]]
    file = read(write(frame[order], tmp_path))
    assert_true(file)
    assert file.notes == ["headings come from quaternions"]
    x, y, z, w = names
    refused(write(frame.rename(columns={x: w, y: x, z: y, w: z}), tmp_path), "are its cells in the order x, y, z, w?")
    refused(write(frame.rename(columns={w: x, x: y, y: z, z: w}), tmp_path), "are its cells in the order w, x, y, z?")
    refused(write(frame.assign(**{w: 0.0}), tmp_path), "expected a quaternion of length 1, got length")


@pytest.mark.parametrize("first", ["w", "x"])
def test_numbered_quaternions_are_told_apart_by_a_robot_that_stands_upright(first, tmp_path):
    half = TRUTH["heading"] / 2 + 0.3
    parts = (
        [np.cos(half), 0 * half, 0 * half, np.sin(half)]
        if first == "w"
        else [0 * half, 0 * half, np.sin(half), np.cos(half)]
    )
    frame = TRUTH.drop(columns="heading").assign(**{f"q{i}": part for i, part in enumerate(parts)})
    cos, sin = np.cos(0.6), np.sin(0.6)
    turned = frame.assign(x=cos * frame["x"] - sin * frame["y"], y=sin * frame["x"] + cos * frame["y"])
    file = read(write(turned, tmp_path), Reading(goal="end", human=(0.0, 5.0)))
    assert np.allclose(file.samples[:, 2], TRUTH["heading"] + 0.6)


def test_headings_come_from_the_motion_where_no_column_tells_them(tmp_path):
    file = read(write(TRUTH.drop(columns="heading"), tmp_path))
    assert_true(file, 0.03)
    assert file.notes == ["headings are those of the motion, for no column tells them"]


@pytest.mark.parametrize(
    ("name", "ids"),
    [
        ("episode_id", ["hall_01", "hall_02", "lab 1"]),
        ("Episode", [7, 3, 5]),
        ("traj", [20240501120000001, 20240501120000002, 20240501120000003]),
        ("run id", [0.0, 1.0, 2.0]),
        ("demoIndex", ["1", "01", "001"]),
        ("trial", [True, False, "maybe"]),
    ],
)
def test_episodes_by_many_names(name, ids, tmp_path):
    frame = pd.concat([TRUTH.assign(**{name: number}) for number in ids])
    assert_true(read(write(frame, tmp_path)), episodes=3)


def test_episodes_that_are_not_told_apart_are_noticed(tmp_path):
    twice = pd.concat([TRUTH, TRUTH])
    refused(write(twice, tmp_path), "row 146, column time", "does another drive begin here?", "column episode")
    on = pd.concat([TRUTH, TRUTH.assign(time=TRUTH["time"] + 14.4)])
    refused(write(on, tmp_path), "row 140: episode 0 reaches its goal here and then drives on, up to 6", how=drive)
    back = TRUTH.iloc[::-1].assign(time=14.4 + TRUTH["time"].to_numpy(), heading=TRUTH["heading"][::-1] + np.pi)
    there_and_back = pd.concat([TRUTH, back])
    refused(write(there_and_back, tmp_path), "reaches its goal here and then drives on, up to 6", how=drive)


def test_rows_out_of_order_repeated_or_without_time(tmp_path):
    doubled = TRUTH.loc[TRUTH.index.repeat(2)]
    file = read(write(doubled, tmp_path))
    assert_true(file)
    assert file.notes == ["144 repeated rows left out"]
    same_time = TRUTH.copy()
    same_time.loc[9, "time"] = same_time.loc[8, "time"]
    refused(write(same_time, tmp_path), "row 11, column time: expected more than 0.8 s")
    refused(write(TRUTH.sample(frac=1, random_state=0), tmp_path), "column time: expected more than")
    gone = TRUTH.copy()
    gone.loc[5, "time"] = None
    refused(write(gone, tmp_path), "row 7, column time: expected a number, got nothing")


def test_a_gap_is_refused_unless_it_is_allowed(tmp_path):
    file = write(TRUTH[(TRUTH["time"] < 3) | (TRUTH["time"] > 4.45)], tmp_path)
    refused(file, "row 32, column time: nothing is told for 1.6 s, expected at most 1 s")
    assert_true(read(file, Reading(max_gap=2)))


def test_angles_of_boxes_in_degrees_are_asked_for_and_full_sides_are_halved(tmp_path):
    box = {"box1_x": 3.0, "box1_y": 2.6, "box1_half_length": 1.0, "box1_half_width": 0.2, "box1_angle": 90.0}
    file = write(TRUTH.assign(**box), tmp_path)
    refused(
        file, "column box1_angle: expected an angle in radians, got 90; is it in degrees?", "--units box1_angle=deg."
    )
    box = read(file, Reading(units={"box1_angle": "deg"})).scene["boxes"]
    assert box.flatten().tolist() == pytest.approx([3, 2.6, 1.0, 0.2, np.pi / 2])
    sides = {"box1_length": 2.0, "box1_width": 0.4, "box1_angle_deg": 90.0, "box1_x": 3.0, "box1_y": 2.6}
    assert np.array_equal(read(write(TRUTH.assign(**sides), tmp_path)).scene["boxes"], box)


@pytest.mark.parametrize("offset", [1e3, 1e5, 5e6])
def test_maps_far_from_the_origin_cost_no_digits(offset, tmp_path):
    shifted = TRUTH.assign(**TRUTH[["x", "goal_x", "human_x"]] + offset)
    data = drive(write(shifted, tmp_path))
    assert data["action"][:, 0].std() < 0.002
    assert f"the origin is laid to ({offset:g}, 0) m" in SAID[0]


def test_a_standing_human_may_be_measured_and_a_walking_one_is_refused(tmp_path):
    rng = np.random.default_rng(0)
    noisy = TRUTH.assign(human_x=3 + rng.normal(0, 0.03, len(TRUTH)), human_y=rng.normal(0, 0.03, len(TRUTH)))
    file = read(write(noisy, tmp_path))
    assert_true(file, 0.01)
    assert "the human lies where it is measured within 0.0" in file.notes[0]
    walking = TRUTH.assign(human_x=4 - 0.1 * TRUTH["time"])
    refused(write(walking, tmp_path), "column human_x: the human walks by 1.4 m, and the world's stands")
    rounded = TRUTH.assign(goal_x=6.0)
    rounded.loc[1, "goal_x"] = 6.0000001
    assert_true(read(write(rounded, tmp_path)))
    seen_late = TRUTH.assign(
        human_x=TRUTH["human_x"].where(TRUTH["time"] > 2), human_y=TRUTH["human_y"].where(TRUTH["time"] > 2)
    )
    assert_true(read(write(seen_late, tmp_path)))


def test_of_several_humans_one_is_named(tmp_path):
    frame = TRUTH.rename(columns={"human_x": "human1_x", "human_y": "human1_y"}).assign(human2_x=3.0, human2_y=3.0)
    file = write(frame, tmp_path)
    refused(file, "holds 2 humans, and the world knows one", "human2_x")
    file = read(file, Reading(columns={"human_x": "human1_x", "human_y": "human1_y"}))
    assert_true(file)
    assert file.ignored == ["human2_x", "human2_y"]


def test_two_columns_that_could_be_the_same_are_asked_for(tmp_path):
    frame = TRUTH.rename(columns={"x": "odom_x", "y": "odom_y"}).assign(amcl_x=TRUTH["x"], amcl_y=TRUTH["y"])
    refused(write(frame, tmp_path), "x could be odom_x or amcl_x; choose with --columns x=NAME")
    assert_true(read(tmp_path / "drive.csv", Reading(columns={"x": "odom_x", "y": "odom_y"})))


def test_goal_and_human_may_be_given(tmp_path):
    file = write(TRUTH[["time", "x", "y", "heading"]], tmp_path)
    refused(file, "expected a column goal_x", "--goal X Y or --goal end")
    refused(file, "expected a column human_x", "--human X Y", reading=Reading(goal="end"))
    assert_true(read(file, Reading(goal=(6, 0), human=(3, 0))))
    file = read(file, Reading(goal="end", human=(3, 0)))
    assert file.scene["goal"][0].tolist() == TRUTH[["x", "y"]].iloc[-1].tolist()


def test_noise_is_smoothed(tmp_path):
    rng, fine = np.random.default_rng(0), bump(30)
    noisy = fine.assign(heading=fine["heading"] + rng.normal(0, 0.05, len(fine)))
    noisy[["x", "y"]] += rng.normal(0, 0.03, (len(fine), 2))
    data = drive(write(noisy, tmp_path))
    assert data["action"][:, 0].std() < 0.05
    wanted = np.interp(0.2 * torch.arange(len(data)), TRUTH["time"], TRUTH["y"])
    assert np.abs(data["pose"][:, 1].numpy() - wanted).max() < 0.05
    assert "poses jitter by" in SAID[0]


@pytest.mark.parametrize("rate", [5, 10, 30, 100])
def test_headings_come_from_a_motion_that_trembles_too(rate, tmp_path):
    places = bump(rate).drop(columns="heading")
    places[["x", "y"]] += np.random.default_rng(0).normal(0, 0.03, (len(places), 2))
    data = drive(write(places, tmp_path))
    wanted = np.interp(0.2 * torch.arange(len(data)), TRUTH["time"], TRUTH["y"])
    assert np.abs(data["pose"][:, 1].numpy() - wanted).max() < 0.1


def test_the_robot_steers_toward_the_path(tmp_path):
    for turned in (1, -1):
        data = drive(write(TRUTH.assign(heading=TRUTH["heading"] + np.radians(turned)), tmp_path))
        wanted = np.interp(0.2 * torch.arange(len(data)), TRUTH["time"], TRUTH["y"])
        assert np.abs(data["pose"][:, 1].numpy() - wanted).max() < 0.02
    jump = TRUTH.assign(y=TRUTH["y"] + 0.12 * (TRUTH["time"] > 6), human_y=-0.2)
    data = drive(write(jump, tmp_path))
    assert data["next", "outcome", "goal"][-1]
    assert (data["pose"][-5:, 1] - 0.12).abs().max() < 0.03
    assert float(SAID[0].partition("followed within ")[2].split()[0]) < 0.13
    refused(tmp_path / "drive.csv", "cannot follow", how=drive, tolerance=0.05)


def test_a_drive_without_a_way_is_refused(tmp_path):
    loop = TRUTH.assign(goal_x=0.1, human_x=3.0)
    refused(
        write(loop, tmp_path), "row 2: episode 0 begins 0.10 m from its goal, where it has arrived already", how=drive
    )
    near = TRUTH[TRUTH["time"] < 1.2].assign(goal_x=0.6, human_x=3.0)
    refused(write(near, tmp_path), "which show nothing; expected 5 or more", how=drive)


def test_all_bad_episodes_are_named_and_the_good_ones_are_taken_on_request(tmp_path):
    drives = [TRUTH.assign(episode=f"run {i}") for i in range(5)]
    drives[1] = drives[1].assign(goal_x=9.0)
    drives[2] = drives[2].assign(y=-TRUTH["y"], heading=-TRUTH["heading"])
    drives[3] = drives[3].assign(human_x=3.0, human_y=1.0)
    drives[4] = drives[4][(TRUTH["time"] < 3) | (TRUTH["time"] > 5)]
    file = write(pd.concat(drives), tmp_path)
    refused(
        file,
        "3 of 5 episodes cannot be taken",
        "episode run 1",
        "from its goal",
        "run 3 touches the human",
        "run 4",
        "2 s",
        how=drive,
    )
    refused(file, "--good-only takes the other 2", how=drive)
    assert drive(file, good_only=True)["episode"].unique().tolist() == [0, 1]
    assert "3 of 5 episodes left out (episode run 1:" in SAID[0]
    refused(write(drives[1], tmp_path), "from its goal", how=drive, good_only=True)


def test_several_files_with_different_numbers_of_boxes_are_read_at_once(tmp_path):
    box = {"box1_x": 3.0, "box1_y": 2.6, "box1_half_length": 0.2, "box1_half_width": 0.2, "box1_angle": 0.0}
    files = [write(TRUTH, tmp_path, "a.csv"), write(TRUTH.assign(**box), tmp_path, "b.csv")]
    data = drive(files)
    assert data["episode"].unique().tolist() == [0, 1]
    assert data["scene", "boxes"].shape[1:] == (1, 5)
    assert len(SAID) == 2


def test_arrays_by_other_names_are_read(tmp_path):
    arrays = {
        "pose": TRUTH[["x", "y", "heading"]].to_numpy(),
        "goal": np.array([[6.0, 0]]),
        "human": np.array([[3.0, 0]]),
    }
    np.savez(tmp_path / "drive.npz", timestamps=TRUTH["time"], **arrays)
    assert_true(read(tmp_path / "drive.npz"))
    np.savez(tmp_path / "drive.npz", **{name: TRUTH[name].to_numpy() for name in TRUTH})
    assert_true(read(tmp_path / "drive.npz"))
    half = TRUTH["heading"].to_numpy() / 2
    quaternion = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], 1)
    parts = {"position": TRUTH[["x", "y"]].to_numpy(), "orientation": quaternion, "t": TRUTH["time"].to_numpy()}
    np.savez(tmp_path / "drive.npz", **parts, goal=arrays["goal"], human=arrays["human"], map=np.zeros((9, 9)))
    file = read(tmp_path / "drive.npz")
    assert_true(file)
    assert file.ignored == ["map"]
    np.savez(tmp_path / "drive.npz", time=TRUTH["time"][:-1], **arrays)
    refused(tmp_path / "drive.npz", "array time: expected the shape [144], got [143]")


def test_tracks_one_below_the_other_need_a_driver(tmp_path):
    """TrajNet++, ETH and UCY: a row per person and moment."""
    slow = bump(2.5).round(4)
    rows = [{"track": {"f": 10 * i, "p": 7, "x": row.x, "y": row.y}} for i, row in slow.iterrows()]
    rows += [{"track": {"f": 10 * i, "p": 9, "x": 3.0, "y": 0.01 * (i % 2)}} for i in range(len(slow))]
    lines = [json.dumps(row) for row in [{"scene": {"id": 0, "p": 7, "s": 0, "e": 350, "fps": 2.5}}, *rows]]
    (tmp_path / "crowd.ndjson").write_text("\n".join(lines))
    refused(tmp_path / "crowd.ndjson", "tells 2 tracks apart (7, 9)", "--robot", "--person")
    how = Reading(robot="7", person="9", goal=(6, 0), rate=25)
    assert_true(read(tmp_path / "crowd.ndjson", how), 0.12)
    refused(tmp_path / "crowd.ndjson", "no track 8", reading=Reading(robot="8", rate=25))
    text = "\n".join(f"{t['f']}\t{t['p']}\t{t['x']}\t{t['y']}" for t in (row["track"] for row in rows))
    (tmp_path / "biwi_eth.txt").write_text(text)
    names = ["frame", "ped_id", "x", "y"]
    assert_true(
        read(tmp_path / "biwi_eth.txt", Reading(names=names, robot="7", person="9", goal=(6, 0), rate=25)), 0.12
    )


def test_what_ros_prints_as_csv_is_known(tmp_path):
    """`ros2 topic echo --csv /odom`: 89 fields without a header."""
    lines = []
    for row in TRUTH.itertuples():
        whole, part = divmod(round(row.time * 1e9), 10**9)
        pose = [row.x, row.y, 0.0, 0.0, 0.0, np.sin(row.heading / 2), np.cos(row.heading / 2)]
        cells = [1730000000 + whole, part, "odom", "base_link", *pose, *[0.0] * 36, 0.45, *[0.0] * 5, *[0.0] * 36]
        lines.append(",".join(map(str, cells)))
    (tmp_path / "odom.csv").write_text("\n".join(lines))
    assert_true(read(tmp_path / "odom.csv", Reading(goal=(6, 0), human=(3, 0))))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"columns": {"foo": "x"}}, "columns: there is no foo; choose from"),
        ({"units": {"tiem": "ms"}}, "units: there is no tiem; did you mean time?"),
        ({"units": {"time": "hours"}}, "units: time is in s, sec"),
        ({"rate": 0}, "rate must be positive, got 0"),
        ({"heading": "left"}, "heading must be motion, clockwise or compass, got left"),
    ],
)
def test_a_wrong_reading_is_refused(settings, words):
    with pytest.raises(ValueError, match=words):
        Reading(**settings)


def test_what_is_said_and_not_needed_is_refused(tmp_path):
    file = write(TRUTH, tmp_path)
    refused(file, "tells times in column time; a rate is for files without", reading=Reading(rate=10))
    refused(file, "v is named and not read; read are time, x, y", reading=Reading(units={"v": "km/h"}))
    refused(file, "is no bag, in which pose would be a topic", reading=Reading(columns={"pose": "/odom"}))
    refused(file, "is no bag, whose scans could show the human", reading=Reading(human="scan"))
    refused(write(TRUTH.assign(v=0.45), tmp_path), "v is named and not read", reading=Reading(columns={"v": "v"}))
    np.savez(tmp_path / "drive.npz", **{name: TRUTH[name].to_numpy() for name in TRUTH})
    refused(tmp_path / "drive.npz", "is no table of text", reading=Reading(separator=";"))
    refused(file, "holds no column of tracks", reading=Reading(robot="3"))
    refused(
        write(TRUTH.rename(columns={"x": "x [furlong]"}), tmp_path), "furlong is no unit of length", "--units x=UNIT"
    )


def test_a_faster_robot_is_asked_for(tmp_path):
    refused(
        write(TRUTH.assign(time=TRUTH["time"] / 3), tmp_path),
        "drives 1.3 m/s, and the robot can 0.5 m/s",
        "world.robot.max_speed",
    )


def test_rows_of_other_things_are_left_out(tmp_path):
    """PlotJuggler: curves of several topics, each with cells of its own."""
    half, odom = TRUTH["heading"] / 2, "/odom/pose/pose"
    curves = {"__time": 1.73e9 + TRUTH["time"], f"{odom}/position/x": TRUTH["x"], f"{odom}/position/y": TRUTH["y"],
              f"{odom}/orientation/x": 0.0, f"{odom}/orientation/y": 0.0, f"{odom}/orientation/z": np.sin(half),
              f"{odom}/orientation/w": np.cos(half), "/odom/header/stamp": 1.73e9 + TRUTH["time"]}  # fmt: skip
    frame = pd.DataFrame(curves)
    others = pd.DataFrame({"__time": frame["__time"] + 0.03, "/person/point/x": 3.0, "/person/point/y": 0.0})
    file = read(write(pd.concat([frame, others]).sort_values("__time"), tmp_path), Reading(goal=(6, 0)))
    assert_true(file)
    assert "144 rows without a pose left out" in file.notes
    assert file.ignored == ["/odom/header/stamp"]


def test_motion_capture_in_millimetres(tmp_path):
    """THÖR: a column per body and axis at 100 Hz, blank where a body is hidden."""
    fine = bump(100)
    frame = pd.DataFrame({"Frame": range(len(fine)), "Time": fine["time"], "Robot X": 1000 * fine["x"],
                          "Robot Y": 1000 * fine["y"], "Robot Z": 300.0, "Helmet_1 X": 3000.0, "Helmet_1 Y": 5.0,
                          "Helmet_2 X": 9000.0, "Helmet_2 Y": 0.0})  # fmt: skip
    frame.loc[300:320, [name for name in frame if name[-1] in "XYZ"]] = None
    file = write(frame, tmp_path, "thor.tsv", sep="\t")
    columns = {"x": "Robot X", "y": "Robot Y", "human_x": "Helmet_1 X", "human_y": "Helmet_1 Y"}
    found = read(file, Reading(columns=columns, units={"length": "mm"}, goal=(6, 0)))
    assert_true(found, 0.06)
    assert found.ignored == ["Frame", "Robot Z", "Helmet_2 X", "Helmet_2 Y"]


def test_a_kilohertz_in_milliseconds_and_millimetres_is_no_slow_drive_over_kilometres(tmp_path):
    fine, lengths = bump(1000), [name for name in TRUTH if name not in ("time", "heading")]
    frame = fine.assign(time=1000 * fine["time"], **1000 * fine[lengths])
    refused(write(frame, tmp_path), "is time in milliseconds?", "--units time=ms length=mm")


def test_what_actions_have_no_use_for_is_refused(tmp_path):
    rows = ["t,v,omega,start_x,start_y,start_heading,goal_x,goal_y,human_x,human_y"]
    rows += [f"{0.2 * i},0.5,0,0,0,0,2,0,1,1" for i in range(20)]
    file = tmp_path / "actions.csv"
    file.write_text("\n".join(rows))
    assert len(import_demonstrations(file, tell=lambda line: None)) == 17
    with pytest.raises(ValueError, match="leave the tolerance out"):
        import_demonstrations(file, tolerance=0.1)
    with pytest.raises(ValueError, match="leave them out"):
        import_demonstrations(file, reading=Reading(max_gap=2))
