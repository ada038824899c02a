import numpy as np
import pandas as pd
import pytest
import torch

from morlnav.navigation.demonstrations import export_demonstrations, import_demonstrations, record_demonstrations
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import PymunkWorld, Scene, SceneSampler, TensorWorld


@pytest.fixture(scope="module")
def data():
    return record_demonstrations(CircumnavigationOracle(), SceneSampler(), 6, num_envs=16)[0]


def straight(speed=0.5, rate=5.0, goal=2.0, seconds=3.5):
    """A table of one drive along the x axis, past a human on the left."""
    time = np.arange(0, seconds, 1 / rate)
    frame = pd.DataFrame({"time": time, "x": speed * time, "y": 0.0, "heading": 0.0})
    return frame.assign(goal_x=goal, goal_y=0.0, human_x=1.0, human_y=1.0)


def write(frame, tmp_path):
    frame.to_csv(tmp_path / "drives.csv", index=False)
    return tmp_path / "drives.csv"


@pytest.mark.parametrize("kind", ["pose", "action"])
@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_what_was_exported_is_imported(data, kind, suffix, tmp_path):
    export_demonstrations(data, tmp_path / f"drives{suffix}", kind)
    again = import_demonstrations(tmp_path / f"drives{suffix}")
    assert set(again.keys(True, True)) == set(data.keys(True, True))
    for key, value in data.items(True, True):
        if value.is_floating_point():
            torch.testing.assert_close(
                again[key], value, atol=2e-3, rtol=1e-4, msg=lambda text, key=key: f"{key}: {text}"
            )
        else:
            assert torch.equal(again[key], value), key


@pytest.mark.parametrize("rate", [2.0, 3.3, 20.0])
def test_other_sampling_rates_are_resampled_along_arcs(data, rate, tmp_path):
    time = np.arange(0, 6, 1 / rate)
    frame = pd.DataFrame({"time": time, "x": np.sin(0.5 * time), "y": 1 - np.cos(0.5 * time), "heading": 0.5 * time})
    frame = frame.assign(goal_x=np.sin(2.8), goal_y=1 - np.cos(2.8), human_x=-2.0, human_y=1.0)
    again = import_demonstrations(write(frame, tmp_path))
    assert torch.allclose(again["action"], torch.tensor([0.5, 0.5]), atol=1e-3)
    angle = 0.1 * torch.arange(len(again))
    circle = torch.stack([angle.sin(), 1 - angle.cos()], -1)
    assert torch.allclose(again["pose"][:, :2], circle, atol=1e-3)


def test_actions_may_come_at_another_rate_too(tmp_path):
    frame = pd.DataFrame({"time": [0.0, 2.0, 3.0], "v": [0.5, 0.25, 0.5], "omega": 0.0})
    frame[["start_x", "start_y", "start_heading"]] = 0.0
    frame = frame.assign(goal_x=1.5, goal_y=0.0, human_x=1.0, human_y=1.0)
    again = import_demonstrations(write(frame, tmp_path))
    assert torch.allclose(again["action"][:10, 0], torch.tensor(0.5), atol=1e-3)
    assert torch.allclose(again["action"][10:, 0], torch.tensor(0.25), atol=1e-3)
    assert again["next", "outcome", "goal"][-1]


def test_a_file_without_times_and_episodes_is_one_episode_of_control_steps(tmp_path):
    again = import_demonstrations(write(straight().drop(columns="time"), tmp_path))
    assert again["episode"].unique().tolist() == [0]
    assert torch.allclose(again["action"], torch.tensor([0.5, 0.0]), atol=1e-4)


def test_what_follows_after_the_goal_is_left_out(tmp_path):
    again = import_demonstrations(write(straight(seconds=6.0), tmp_path))
    assert len(again) == 17  # 1.65 m to the goal's disc
    assert again["next", "pose"][-1, 0] == pytest.approx(1.65, abs=0.026)


def test_noisy_poses_are_followed(tmp_path):
    frame = straight(speed=0.4, seconds=4.4)
    rng = np.random.default_rng(0)
    frame[["x", "y"]] += rng.normal(0, 0.005, (len(frame), 2))
    frame["heading"] += rng.normal(0, 0.02, len(frame))
    again = import_demonstrations(write(frame, tmp_path))
    assert again["next", "outcome", "goal"][-1]
    assert again["action"][:, 0].mean() == pytest.approx(0.4, abs=0.02)


def test_scenes_may_have_different_numbers_of_boxes(tmp_path):
    one, other = straight(), straight()
    one[["box1_x", "box1_y", "box1_half_length", "box1_half_width", "box1_angle"]] = [1.0, -1.5, 0.2, 0.2, 0.0]
    frame = pd.concat([one.assign(episode=7), other.assign(episode=3)])
    again = import_demonstrations(write(frame, tmp_path))
    assert again["episode"].unique().tolist() == [0, 1]
    nearest = [again["observation"][again["episode"] == number, 4:].min() for number in (0, 1)]
    assert nearest[1] == pytest.approx(0.7, abs=0.01)  # the human alone
    assert again["scene", "boxes"][again["episode"] == 0][0, 0, 1] == -1.5


def test_the_reference_engine_drives_them_too(tmp_path):
    assert import_demonstrations(write(straight(), tmp_path), world=PymunkWorld())["next", "done"][-1]


def test_observations_are_those_at_the_poses(data, tmp_path):
    export_demonstrations(data, tmp_path / "drives.npz")
    again, world = import_demonstrations(tmp_path / "drives.npz"), TensorWorld()
    scene = Scene.from_tensordict(again["scene"].clone().set("start", again["pose"]))
    world.scene, world.pose = scene, again["pose"]
    torch.testing.assert_close(world.observe(), again["observation"], atol=1e-4, rtol=1e-4)


def spoil(column, row, value):
    def change(frame):
        frame[column] = frame[column].astype(object)
        frame.loc[row, column] = value
        return frame

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (spoil("x", 3, "abc"), r"drives.csv, row 5, column x: expected a number, got 'abc'"),
        (spoil("heading", 0, None), r"row 2, column heading: expected a number, got nothing"),
        (spoil("y", 2, "inf"), r"row 4, column y: expected a finite number, got inf"),
        (spoil("goal_x", 4, 9.0), r"row 6, column goal_x: expected 2 as before in this episode, got 9"),
        (spoil("time", 4, 0.1), r"row 6, column time: expected more than 0.6 s, .* got 0.1 s"),
        (spoil("y", 6, 3.0), r"row 8: the robot cannot follow, it would be 2.\d\d m and 0.\d\d rad off"),
        (lambda frame: frame.drop(columns="human_y"), r"expected a column human_y; the columns are time, x, y"),
        (lambda frame: frame.drop(columns="x"), r"expected columns x, y, heading or v, omega, got neither"),
        (
            lambda frame: frame.assign(goal_x=3.0),
            r"row 19: episode 0 ends 1.30 m from its goal, expected at most 0.35 m",
        ),
        (lambda frame: frame.assign(human_x=1.2, human_y=0.3), r"row 11: episode 0 touches the human here"),
        (lambda frame: frame.assign(human_x=0.1, human_y=0.0), r"episode 0: The start lies inside the human"),
        (lambda frame: frame.assign(x=-frame["x"], goal_x=-2.0), r"column heading: .* does it drive backwards"),
        (lambda frame: frame[:1], r"row 2: episode 0 has a single pose, expected two or more"),
        (lambda frame: frame[:0], r"holds no sample"),
        (lambda frame: frame.assign(box1_x=5.0), r"expected a column box1_y"),
        (
            lambda frame: frame.assign(box1_x=5, box1_y=5, box1_half_length=1, box1_half_width=None, box1_angle=0),
            r"episode 0: box1 needs all of x, y, half_length",
        ),
    ],
)
def test_a_wrong_table_ends_in_one_sentence(change, words, tmp_path):
    with pytest.raises(ValueError, match=words) as caught:
        import_demonstrations(write(change(straight()), tmp_path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pose": np.zeros((5, 2))}, r"array pose: expected the shape \[5, 3\], got \[5, 2\]"),
        ({"goal": np.zeros(2)}, r"array goal: expected the shape \[1, 2\], got \[2\]"),
        ({"human": None}, r"expected a column human_x; the columns are x, y, heading, goal_x, goal_y"),
        ({"boxes": np.zeros((1, 2, 4))}, r"array boxes: expected the shape \[1, K, 5\]"),
        ({"time": np.zeros(4)}, r"array time: expected the shape \[5\]"),
        ({"pose": np.array([object()])}, r"is no .npz file of numbers"),
        ({"pose": None}, r"expected an array pose or action, got neither"),
    ],
)
def test_wrong_arrays_end_in_one_sentence(change, words, tmp_path):
    arrays = {"pose": np.zeros((5, 3)), "goal": np.ones((1, 2)), "human": np.ones((1, 2))} | change
    np.savez(tmp_path / "drives.npz", **{name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(ValueError, match=words):
        import_demonstrations(tmp_path / "drives.npz")


def test_too_fast_an_action_is_refused(tmp_path):
    frame = pd.DataFrame({"v": [0.5, 0.9], "omega": 0.0, "start_x": 0.0, "start_y": 0.0, "start_heading": 0.0})
    frame = frame.assign(goal_x=2.0, goal_y=0.0, human_x=1.0, human_y=1.0)
    with pytest.raises(ValueError, match=r"row 3, column v: expected 0 to 0.5, got 0.9"):
        import_demonstrations(write(frame, tmp_path))


def test_an_action_backwards_is_not_taken_for_one_in_other_units(tmp_path):
    frame = pd.DataFrame({"v": [0.5, -0.4], "omega": 0.0, "start_x": 0.0, "start_y": 0.0, "start_heading": 0.0})
    frame = frame.assign(goal_x=2.0, goal_y=0.0, human_x=1.0, human_y=1.0)
    with pytest.raises(ValueError, match=r"row 3, column v: expected 0 to 0.5, got -0.4\.$"):
        import_demonstrations(write(frame, tmp_path))


def test_other_files_are_refused(data, tmp_path):
    with pytest.raises(FileNotFoundError, match="no file"):
        import_demonstrations(tmp_path / "nowhere.csv")
    (tmp_path / "drives.txt").write_text("x")
    with pytest.raises(ValueError, match=r"drives.txt holds no sample"):
        import_demonstrations(tmp_path / "drives.txt")
    with pytest.raises(ValueError, match="'pose' or 'action'"):
        export_demonstrations(data, tmp_path / "drives.csv", "speed")
