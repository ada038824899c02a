from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageSequence

from morlnav.commands.evaluate import animate_run, main
from morlnav.navigation.evaluation import evaluate_policy, evaluation_scenes
from morlnav.navigation.record.animation import animate_rollouts
from morlnav.runs import Run


@pytest.fixture(scope="module")
def rollouts():
    def straight(observation, preference):
        return torch.stack([0.5 * preference[:, 0], torch.zeros(len(observation))], -1)

    return evaluate_policy(straight, evaluation_scenes(2), torch.tensor([[1.0, 0.0], [0.5, 0.5]]), max_steps=8)


def test_every_robot_moves_from_its_start_to_where_it_ended(rollouts, tmp_path):
    animation = animate_rollouts(rollouts, scene=1, stride=4)
    animation.save(tmp_path / "drive.png", writer="pillow", dpi=30)
    robots = animation._fig.axes[0].patches[-2:]
    np.testing.assert_allclose([robot.center for robot in robots], rollouts.pose[:, 1, -1, :2], rtol=1e-6)
    frames = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(Image.open(tmp_path / "drive.png"))]
    assert len(frames) == 3  # steps 0, 4 and 8
    assert not any((one == other).all() for one, other in pairwise(frames))


def test_the_last_step_is_a_frame_whatever_the_stride(rollouts, tmp_path):
    animation = animate_rollouts(rollouts, stride=3)
    animation.save(tmp_path / "drive.gif", writer="pillow", dpi=30)
    robot = animation._fig.axes[0].patches[-2]
    np.testing.assert_allclose(robot.center, rollouts.pose[0, 0, -1, :2], rtol=1e-6)


def test_the_knob_in_motion_is_one_command_away(smoke_run, tmp_path, monkeypatch, capsys):
    words = ["--animate", str(tmp_path / "new" / "knob.gif"), "--scene", "1", "--threads", "1"]
    monkeypatch.setattr("sys.argv", ["morlnav-evaluate", str(smoke_run), *words])
    main()
    with Image.open(tmp_path / "new" / "knob.gif") as picture:
        assert picture.n_frames > 2
    assert "knob.gif" in capsys.readouterr().out


def test_an_animation_is_a_gif(smoke_run, tmp_path):
    with pytest.raises(ValueError, match=r"The animation is a GIF; give it a name such as knob\.gif, not knob\.mp4"):
        animate_run(Run(smoke_run), Path("knob.mp4"))
    with pytest.raises(ValueError, match=r"below evaluation.episodes=\d+, got 1000"):
        animate_run(Run(smoke_run), tmp_path / "knob.gif", scene=1000)


def test_few_preferences_are_named_in_words(rollouts, tmp_path):
    animation = animate_rollouts(rollouts)
    animation.save(tmp_path / "drive.gif", writer="pillow", dpi=30)
    (legend,) = animation._fig.legends
    assert [text.get_text() for text in legend.get_texts()] == ["distance", "distance 0.5, efficiency 0.5"]


def test_what_cannot_be_shown_is_explained(rollouts):
    with pytest.raises(ValueError, match="below 2, got 2"):
        animate_rollouts(rollouts, scene=2)
    with pytest.raises(ValueError, match="2 entries"):
        animate_rollouts(rollouts, ("demo", "distance", "efficiency"))
