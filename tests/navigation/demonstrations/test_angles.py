"""Angles in any unit, counted in any direction: what they may mean is asked, and the answer is right."""

import numpy as np
import pytest
from drives import TRUTH, assert_true, read, refused, write

from morlnav.navigation.demonstrations import Reading
from morlnav.navigation.demonstrations.names import UNITS

UNIT = {"rad": "", "deg": "in degrees", "pi": "in half turns", "turn": "in turns", "gon": "in gon",
        "mrad": "in milliradians", "cdeg": "in hundredths of a degree"}  # fmt: skip
WAYS = {
    "": (lambda h: h, ""),
    "modulo a turn": (lambda h: h % (2 * np.pi), ""),
    "clockwise": (np.negative, "does it count clockwise"),
    "compass": (lambda h: np.pi / 2 - h, "is it a compass's, clockwise from the y axis"),
    "backwards": (lambda h: h + np.pi, "does it drive backwards, which ours cannot, or is it just turned"),
    "from the y axis": (lambda h: h - np.pi / 2, "is it counted from the y axis"),
    "from the -y axis": (lambda h: h + np.pi / 2, "is it counted from the -y axis"),
}
BOX = {"box1_x": 3.0, "box1_y": 3.0, "box1_half_length": 0.5, "box1_half_width": 0.3}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("unit", UNIT)
def test_headings_that_do_not_lead_along_the_drive_are_asked_for(unit, way, tmp_path):
    turn, question = WAYS[way]
    file = write(TRUTH.assign(heading=turn(TRUTH["heading"]) / UNITS["angle"][unit]), tmp_path)
    if (UNIT[unit], question) == ("", ""):
        return assert_true(read(file))
    option = way if way in ("clockwise", "compass") else "motion" if question else None
    units = {"heading": unit} if UNIT[unit] and option != "motion" else {}
    asked = [f"is it {UNIT[unit]}"] * bool(UNIT[unit]) + [question] * bool(question)
    words = [f"--units heading={unit}"] * bool(units) + [f"--heading {option}"] * bool(option)
    refused(file, "column heading: the robot would look ", f"{' and '.join(asked)}? Then: {' '.join(words)}.")
    return assert_true(read(file, Reading(units=units, heading=option)), 0.01)


@pytest.mark.parametrize(
    ("name", "reading", "answer"),
    [
        ("yaw_deg", {}, "is it in radians? Then: --units heading=rad."),
        ("yaw", {"units": {"heading": "deg"}}, "is it in radians? Then: --units heading=rad."),
        ("yaw", {"heading": "clockwise"}, "does it count counter-clockwise? Then: leave --heading out."),
    ],
)
def test_what_was_told_wrongly_is_asked_for_too(name, reading, answer, tmp_path):
    refused(write(TRUTH.rename(columns={"heading": name}), tmp_path), answer, reading=Reading(**reading))


def test_a_bend_in_a_long_straight_drive_tells_the_unit(tmp_path):
    time = np.arange(0, 40, 0.1)
    heading = np.interp(time, [32, 38], [0.0, 1.2])
    x, y = (np.concatenate([[0], 0.04 * part(heading[:-1]).cumsum()]) for part in (np.cos, np.sin))
    drive = TRUTH.iloc[[0] * 400].assign(time=time, x=x, y=y, heading=heading / np.pi, human_y=2.0)
    refused(write(drive, tmp_path), "is it in half turns?", reading=Reading(goal="end"))


@pytest.mark.parametrize("noise", [{"scale": 0.05}, {"loc": 0.06, "scale": 0.0}])
def test_a_compass_that_is_a_little_off_is_let_pass(noise, tmp_path):
    off = np.random.default_rng(0).normal(size=len(TRUTH), **noise)
    read(write(TRUTH.assign(heading=TRUTH["heading"] + off), tmp_path))


@pytest.mark.parametrize(
    ("angle", "otherwise"), [(5, True), (3.0, True), (-2, True), (45, False), (-90, False), (22.5, False), (400, False)]
)
def test_boxes_turned_by_whole_numbers_or_beyond_a_turn_are_asked_for(angle, otherwise, tmp_path):
    file, if_not = (
        write(TRUTH.assign(**BOX, box1_angle=angle), tmp_path),
        "; if not: --units box1_angle=rad" * otherwise,
    )
    asked = f"got {abs(angle):g}; is it in degrees? Then: --units box1_angle=deg{if_not}."
    refused(file, f"column box1_angle: expected an angle in radians, {asked}")
    for unit in ("deg", "rad"):
        there = read(file, Reading(units={"box1_angle": unit})).scene["boxes"][0, 0, 4]
        assert there == pytest.approx(angle * UNITS["angle"][unit])


def test_all_boxes_are_asked_for_at_once(tmp_path):
    other = {name.replace("box1", "box7"): value for name, value in BOX.items()}
    file = write(TRUTH.assign(**BOX, box1_angle=90, **other, box7_angle=30), tmp_path)
    refused(file, "Then: --units box1_angle=deg box7_angle=deg.")
    boxes = read(file, Reading(units={"box1_angle": "deg", "box7_angle": "deg"})).scene["boxes"]
    assert np.degrees(boxes[0, :, 4]) == pytest.approx([90, 30])


def test_boxes_are_asked_for_where_the_heading_is_in_degrees(tmp_path):
    frame = TRUTH.assign(**BOX, box1_angle=2.5, heading=np.degrees(TRUTH["heading"]))
    file = write(frame.rename(columns={"heading": "yaw_deg"}), tmp_path)
    refused(file, "column box1_angle: expected an angle in radians, got 2.5; is it in degrees?")


@pytest.mark.parametrize("angle", [0, 0.0, 1.57, -3.1, 6.28])
def test_boxes_in_radians_are_not_asked_for(angle, tmp_path):
    assert read(write(TRUTH.assign(**BOX, box1_angle=angle), tmp_path)).scene["boxes"][0, 0, 4] == angle
