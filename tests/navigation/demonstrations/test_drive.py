"""Driving by hand: real events, the real environment, and what is saved."""

import os
import sys

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

import pytest
import torch

pygame = pytest.importorskip("pygame")

from morlnav.commands import record
from morlnav.navigation.demonstrations import (
    RecordedFolder,
    demonstration_settings,
    export_demonstrations,
    load_demonstrations,
    record_demonstrations,
    recorded_demonstrations,
    save_demonstrations,
)
from morlnav.navigation.demonstrations.drive import Controls, Recorder, add_demonstrations
from morlnav.navigation.demonstrations.window import SceneWindow
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import DifferentialDrive, Lidar, Scene, SceneSampler, TensorWorld

KEYS = {"up": pygame.K_UP, "left": pygame.K_LEFT, "right": pygame.K_RIGHT, "shift": pygame.K_LSHIFT}
KEYS |= {"escape": pygame.K_ESCAPE, "n": pygame.K_n, "r": pygame.K_r}


def scenes(count, human=(1.0, 1.0), **_):
    """The goal is 2 m straight ahead."""
    goal, start = torch.tensor([2.0, 0.0]).expand(count, 2), torch.zeros(count, 3)
    boxes = torch.tensor([[[1.0, -1.2, 0.3, 0.2, 0.5]]]).expand(count, 1, 5)
    human = torch.tensor(human).expand(count, 2)
    return Scene(start=start, goal=goal, human=human, boxes=boxes, batch_size=[count])


def press(name, down=True):
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN if down else pygame.KEYUP, key=KEYS[name]))


@pytest.fixture
def window():
    window = SceneWindow(TensorWorld(), size=(400, 300))
    yield window
    window.close()


@pytest.fixture
def recorder(window):
    kept = []
    recorder = Recorder(window.world, scenes, kept.append, window, frame_rate=None)
    recorder.kept = kept
    recorder.draw()
    return recorder


def drive_on(recorder, steps):
    for _ in range(steps):
        assert recorder.listen()
        recorder.step(recorder.controls.action(recorder.env.world, recorder.window))


def test_held_keys_drive_the_robot_and_an_arrival_is_kept(recorder):
    drive_on(recorder, 3)
    assert not recorder.frames  # nothing is recorded before the first move
    press("up")
    drive_on(recorder, 17)
    (episode,) = recorder.kept
    assert episode["next", "outcome", "goal"].flatten().tolist() == [False] * 16 + [True]
    assert torch.equal(episode["action"], torch.tensor([0.5, 0.0]).expand(17, 2))
    assert torch.allclose(episode["pose"][:, 0], 0.1 * torch.arange(17))
    assert "1 demonstrations are saved" in recorder.news
    assert not recorder.frames


def test_turning_and_slowing_down(recorder):
    press("left")
    press("shift")
    press("up")
    drive_on(recorder, 1)
    assert torch.allclose(recorder.frames[0]["action"], torch.tensor([[0.25, 0.6]]))
    press("left", down=False)
    press("shift", down=False)
    press("right")
    drive_on(recorder, 1)
    assert torch.allclose(recorder.frames[1]["action"], torch.tensor([[0.5, -1.2]]))


def test_the_mouse_leads_the_robot(recorder, window):
    target = window.to_screen(torch.tensor([1.0, 0.4]))
    pixel = tuple(map(round, target))
    pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, pos=pixel, button=1))
    drive_on(recorder, 9)
    pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONUP, pos=pixel, button=1))
    drive_on(recorder, 1)
    here = recorder.env.world.pose[0, :2]
    assert (here - torch.tensor([1.0, 0.4])).norm() < 0.35
    assert not recorder.frames[-1]["action"].any()


def test_a_collision_begins_the_same_scene_again_and_keeps_nothing(window):
    kept = []
    recorder = Recorder(window.world, lambda count, **_: scenes(count, human=(1.0, 0.0)), kept.append, window)
    press("up")
    drive_on(recorder, 6)
    assert not kept
    assert "touched the human" in recorder.news
    assert torch.equal(recorder.env.world.pose[0], torch.zeros(3))


def test_another_scene_or_the_same_again_is_a_key_away(window):
    recorder = Recorder(window.world, SceneSampler(), lambda _: None, window)
    first = recorder.env.world.scene.goal.clone()
    press("up")
    drive_on(recorder, 2)
    press("r")
    recorder.listen()
    assert torch.equal(recorder.env.world.scene.goal, first)
    assert not recorder.frames
    press("n")
    recorder.listen()
    assert not torch.equal(recorder.env.world.scene.goal, first)


def test_everything_is_drawn(recorder, window):
    press("up")
    drive_on(recorder, 5)
    recorder.draw()
    scene = recorder.env.world.scene[0]

    def colour(point):
        return tuple(window.surface.get_at(tuple(map(round, window.to_screen(torch.as_tensor(point)))))[:3])

    assert colour(scene.human) == pygame.Color("#e05252")[:3]
    assert colour(scene.goal) == pygame.Color("#2456d6")[:3]
    assert colour(scene.boxes[0, :2]) == pygame.Color("#c4c7cc")[:3]
    assert colour([0.2, 0.0]) == pygame.Color("#18a572")[:3]  # the path
    assert colour(recorder.env.world.pose[0, :2]) == pygame.Color("#333333")[:3]
    bearing = torch.tensor([0.5, 1.0]) / torch.tensor([0.5, 1.0]).norm()
    assert colour(torch.tensor([0.5, 0.0]) + 0.4 * bearing) == pygame.Color("#f4eee4")[:3]  # the lidar sees the human


@pytest.mark.parametrize("end", ["escape", "quit", "crash"])
def test_however_it_ends_what_arrived_is_saved(end, tmp_path, monkeypatch, capsys):
    class Hasty(Recorder):
        def __init__(self, world, _, keep, window, seed):
            super().__init__(world, scenes, keep, window, seed, frame_rate=None)
            press("up")

        def step(self, action):
            super().step(action)
            if self.count == 2 and len(self.frames) == 3:  # in the middle of the third drive
                if end == "crash":
                    raise KeyboardInterrupt
                press("escape") if end == "escape" else pygame.event.post(pygame.event.Event(pygame.QUIT))

    monkeypatch.setattr(record, "Recorder", Hasty)
    monkeypatch.setattr(sys, "argv", ["morlnav-record", str(tmp_path / "mine"), "--size", "300", "200"])
    if end == "crash":
        with pytest.raises(SystemExit, match="Interrupted"):
            record.main()
    else:
        record.main()
        assert "mine holds 2 demonstrations" in capsys.readouterr().out
    data = load_demonstrations(tmp_path / "mine")
    assert data["episode"].unique().tolist() == [0, 1]
    assert len(data) == 34
    settings = demonstration_settings(tmp_path / "mine")
    assert settings == {"source": "driven by hand", "world": TensorWorld().settings}
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.parametrize("size", [("0", "0"), ("-300", "200"), ("300", "5")])
def test_a_window_in_which_nothing_could_be_seen_is_refused(size, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["morlnav-record", str(tmp_path / "mine"), "--size", *size])
    with pytest.raises(SystemExit, match=f"at least 100 pixels in width and height, got {size[0]} by {size[1]}"):
        record.main()
    assert not (tmp_path / "mine").exists()


def test_recordings_grow_from_drive_to_drive(tmp_path):
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 2, num_envs=4)
    assert add_demonstrations(data, tmp_path / "mine", "first") == 2
    assert add_demonstrations(data[data["episode"] == 1], tmp_path / "mine", "second") == 3
    assert load_demonstrations(tmp_path / "mine")["episode"].unique().tolist() == [0, 1, 2]
    other = data.clone()
    other["observation"] = other["observation"][:, :24]
    with pytest.raises(ValueError, match="their observations hold 24 and 34 numbers; record into another folder"):
        add_demonstrations(other, tmp_path / "mine", "third")
    assert load_demonstrations(tmp_path / "mine")["episode"].max() == 2
    assert demonstration_settings(tmp_path / "mine") == {"source": "first, second"}
    (tmp_path / "mine").rename(tmp_path / "mine.old")  # as a kill in between would leave it
    assert add_demonstrations(data[data["episode"] == 1], tmp_path / "mine", "fourth") == 4
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_folder_behind_a_link_grows_there(tmp_path):
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 1, num_envs=4)
    (tmp_path / "disk").mkdir()
    (tmp_path / "mine").symlink_to("disk")
    assert [add_demonstrations(data, tmp_path / "mine", "me") for _ in range(3)] == [1, 2, 3]
    assert (tmp_path / "mine").is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disk", "mine"]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["drives.csv", "--columns", "x=x", "x=y"], "--columns tells x twice"),
        (["drives.csv", "drives.csv"], "drives.csv is named twice"),
        (["drives.csv", "--tolerance", "nan"], "tolerance must be positive"),
        (["minari:none-v0", "--columns", "x=y"], "leave the options of import out"),
        (["minari:none-v0", "--good-only"], "leave the options of import out"),
    ],
)
def test_words_that_contradict_each_other_or_do_nothing(words, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 1, num_envs=4)
    export_demonstrations(data, tmp_path / "drives.csv")
    monkeypatch.setattr(sys, "argv", ["morlnav-record", "mine", "--import", *words])
    with pytest.raises(SystemExit, match=sentence):
        record.main()
    assert not (tmp_path / "mine").exists()


def test_a_file_is_imported_by_one_command(tmp_path, monkeypatch, capsys):
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 2, num_envs=4)
    export_demonstrations(data, tmp_path / "drives.csv")
    words = ["morlnav-record", str(tmp_path / "mine"), "--import", str(tmp_path / "drives.csv"), "env.num_envs=4"]
    monkeypatch.setattr(sys, "argv", words)
    record.main()
    assert "mine holds 2 demonstrations" in capsys.readouterr().out
    assert len(load_demonstrations(tmp_path / "mine")) == len(data)
    (tmp_path / "drives.csv").write_text("x,y\n1,2\n")
    with pytest.raises(SystemExit, match=r"drives\.csv: expected a column goal_x; the columns are x, y;"):
        record.main()


def test_other_events_are_let_pass(window):
    controls = Controls()
    assert controls.hear(pygame.event.Event(pygame.WINDOWEXPOSED)) is None
    assert not controls.action(window.world, window).any()


def test_a_recording_belongs_to_its_world(tmp_path):
    fast = TensorWorld(robot=DifferentialDrive(max_speed=1.5))
    oracle = CircumnavigationOracle(speed=1.0)
    data, _ = record_demonstrations(oracle, SceneSampler(num_boxes=0), 1, num_envs=4, world=fast)
    assert add_demonstrations(data, tmp_path / "mine", "a.csv", fast) == 1
    words = (
        r"mine were recorded with robot.max_speed=1.5 \(here 0.5\); set env.world.robot.max_speed=1.5, or record anew"
    )
    with pytest.raises(ValueError, match=words):
        add_demonstrations(data, tmp_path / "mine", "b.csv", TensorWorld())
    with pytest.raises(ValueError, match=words):
        recorded_demonstrations(tmp_path / "mine", world=TensorWorld())
    with pytest.raises(ValueError, match=words):
        RecordedFolder(str(tmp_path / "mine"), world=TensorWorld(), scenes=SceneSampler())
    assert recorded_demonstrations(tmp_path / "mine", world=fast)[1] == 1
    seen_otherwise = TensorWorld(robot=fast.robot, step_time=0.1, lidar=Lidar(max_range=8.0), human_radius=0.4)
    with pytest.raises(ValueError, match=r"step_time=0.2 \(here 0.1\) and human_radius=.* and lidar.max_range=4"):
        recorded_demonstrations(tmp_path / "mine", world=seen_otherwise)


def test_a_folder_that_tells_no_world_is_held_against_this_one(tmp_path):
    fast = TensorWorld(robot=DifferentialDrive(max_speed=1.5))
    for name, world, words in [
        ("fast", fast, r"fast drive up to 1.00 m/s, the world's robot 0.5"),
        ("slow", TensorWorld(step_time=0.1), r"do not get from pose to pose by their actions in steps of 0.2 s"),
    ]:
        oracle = CircumnavigationOracle(speed=1.0 if name == "fast" else 0.5)
        data, _ = record_demonstrations(oracle, SceneSampler(num_boxes=0), 1, num_envs=4, world=world)
        save_demonstrations(data, tmp_path / name)
        with pytest.raises(ValueError, match=words):
            recorded_demonstrations(tmp_path / name)


def test_folders_with_different_numbers_of_boxes_train_together(tmp_path):
    for boxes in (1, 3):
        data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(num_boxes=boxes), 2, num_envs=4)
        add_demonstrations(data, tmp_path / f"boxes{boxes}", "me", TensorWorld())
        add_demonstrations(data, tmp_path / "both", f"boxes{boxes}", TensorWorld())
    folders = [str(tmp_path / f"boxes{boxes}") for boxes in (1, 3)]
    source = RecordedFolder(folders, world=TensorWorld(), scenes=SceneSampler())
    together = source.collect(10)
    assert together["episode"].unique().tolist() == [0, 1, 2, 3]
    assert together["scene", "boxes"].shape[1:] == (3, 5)
    assert (together == load_demonstrations(tmp_path / "both")).all()
    source.save(together, tmp_path / "cached")
    assert (source.load(tmp_path / "cached") == together).all()
    assert source.key != RecordedFolder(folders[0], world=TensorWorld(), scenes=SceneSampler()).key
