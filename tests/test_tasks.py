"""Tasks other than navigation train, continue and report by config alone."""

import re
import signal
import sys
from pathlib import Path

import moocore
import pandas as pd
import pytest
from hydra import compose, initialize_config_dir

from morlnav.cli import conf_dir
from morlnav.commands.train import run
from morlnav.runs import Run
from morlnav.trainers.checkpoint import find_checkpoints

CAR = ("env=mo_gymnasium", "env.id=mo-mountaincarcontinuous-v0", "exploration=held")
BRIEF = ("trainer=smoke", "trainer.progress_bar=false", "actor.num_cells=16", "critic.num_cells=16", "cache=null")

PAGE = (Path(__file__).parents[1] / "docs" / "tasks.md").read_text()
MY_TASK = re.search(r'^```python title="my_task.py"\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE)[1]
MORE = """

def bounded_by_itself():
    from torchrl.envs import StepCounter, TransformedEnv

    return TransformedEnv(Between(4), StepCounter(7, step_count_key="own_count"))


class Blind(Between):
    def __init__(self):
        super().__init__(4)
        self.observation_spec = Composite(place=Bounded(-1, 1, (4, 1)), shape=[4])
"""


def configure(*words):
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        return compose("train", list(words))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run on a task of MO-Gymnasium that was interrupted and continued. Read it only."""
    directory = tmp_path_factory.mktemp("car") / "run"
    with pytest.MonkeyPatch.context() as patch:
        interrupt_at(patch, 256)
        assert run(configure(*CAR, *BRIEF), directory) is None
    checkpoint = find_checkpoints(directory)[-1]
    run(configure(*CAR, *BRIEF, f"resume='{checkpoint}'"), directory)
    return directory


def interrupt_at(patch, frames):
    """Press Ctrl-C as soon as so many frames are collected."""
    from morlnav.trainers import LogEpisodes

    call = LogEpisodes.__call__

    def pressed(hook, batch):
        if hook.trainer.collected_frames >= frames:
            signal.raise_signal(signal.SIGINT)
        return call(hook, batch)

    patch.setattr(LogEpisodes, "__call__", pressed)


@pytest.fixture
def my_task(tmp_path, monkeypatch):
    """The module that the page tells to write, with what else can go right or wrong in one."""
    (tmp_path / "my_task.py").write_text(MY_TASK + MORE)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("my_task", None)


# MO-Gymnasium


def test_a_continued_run_has_all_its_frames_and_files(finished):
    names = {path.name for path in (finished / "evaluation").iterdir()}
    assert {"front.csv", "front.png", "table.md"} <= names
    assert find_checkpoints(finished)[-1].name.endswith("512")
    rows = [pd.read_csv(path, header=None) for path in finished.glob("logs/**/*loss_qvalue.csv")]
    assert rows[0][0].tolist() == list(range(64, 513, 64))  # as if it had never been interrupted
    assert Run(finished).policy.objectives == ("objective_0", "objective_1")


def test_resuming_says_that_episodes_begin_anew(finished, tmp_path, capsys):
    run(configure(*CAR, *BRIEF, f"resume='{finished}'"), tmp_path / "again")
    assert "Its episodes cannot be saved, so new ones begin" in capsys.readouterr().out


def test_the_reported_hypervolume_is_that_of_other_libraries(finished):
    indicators = pytest.importorskip("morl_baselines.common.performance_indicators")
    front = pd.read_csv(finished / "evaluation" / "front.csv")
    points = front.filter(regex="^return_").to_numpy()
    reference = front.filter(regex="^reference_").to_numpy()[0]
    reported = front["hypervolume"][0]
    assert reported > 0
    assert moocore.hypervolume(points, ref=reference, maximise=True) == pytest.approx(reported)
    assert indicators.hypervolume(reference, list(points)) == pytest.approx(reported)


def test_the_reference_point_is_one_step_below_the_worst_episode(finished):
    front = pd.read_csv(finished / "evaluation" / "front.csv")
    assert front.filter(regex="^reference_").to_numpy()[0].tolist() == [-51.0, -51.0]  # 50 steps of -1 at least


def test_the_utility_is_what_the_loss_weighs(finished):
    front = pd.read_csv(finished / "evaluation" / "front.csv")
    weighed = (front.filter(regex="^lambda_").to_numpy() * front.filter(regex="^return_").to_numpy()).sum(1)
    assert front["utility"].tolist() == pytest.approx(weighed.tolist())
    assert front["expected_utility"][0] == pytest.approx(weighed.mean())


def test_a_terminal_shows_every_column(finished, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    Run(finished).evaluation.show(finished / "evaluation", finished)
    text = capsys.readouterr().out
    assert "utility" in text
    assert "hypervolume" in text
    assert max(map(len, text.splitlines())) <= 80


def test_without_bounds_of_the_rewards_the_report_says_why_there_is_no_hypervolume(tmp_path):
    words = ("env=mo_gymnasium", "env.id=mo-hopper-2obj-v5", "env.num_envs=2", "trainer.total_frames=64")
    finished = run(configure(*BRIEF, *words, "evaluation.episodes=1"), tmp_path / "run")
    front = pd.read_csv(finished.directory / "evaluation" / "front.csv")
    assert front["hypervolume"].isna().all()
    assert "No hypervolume" in (finished.directory / "evaluation" / "table.md").read_text()
    given = Run(finished.directory, changes={"reference": [-100.0, -100.0]})
    given.evaluation.report(given.policy, tmp_path / "given")
    assert pd.read_csv(tmp_path / "given" / "front.csv")["hypervolume"][0] > 0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("env.id=mo-hoper-2obj-v5",), "did you mean mo-hopper-2obj-v5"),
        (("env.id=water-reservoir-v0",), "bounds must be finite"),
        (("env.id=mo-hopper-v5", "evaluation.reference=[-1]"), "reference needs 3 numbers"),
        (("env.id=mo-hopper-v5", "env.num_envs=3"), "must be a positive multiple of the 3 environments"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_written(words, sentence, tmp_path):
    with pytest.raises(ValueError, match=sentence):
        run(configure("env=mo_gymnasium", *words), tmp_path / "run")
    assert not (tmp_path / "run").exists()


# A task of one's own

OWN = ("env=own", "transforms.time_limit.max_steps=16", "trainer.progress_bar=false", "cache=null")
SMALL = (
    "actor.num_cells=32",
    "critic.num_cells=32",
    "replay.batch_size=64",
    "evaluation.steps=2",
    "trainer.optim_steps_per_batch=16",
)


def test_a_policy_learns_in_an_environment_of_ones_own(my_task, tmp_path):
    words = ("env._target_=my_task.Between", "+env.num_envs=8", "trainer.total_frames=4096")
    finished = run(configure(*OWN, *SMALL, *words, "collector.init_random_frames=512"), tmp_path / "run")
    env = finished.training.make_env({}).base_env
    assert (type(env).__module__, env.batch_size) == ("my_task", (8,))
    front = pd.read_csv(tmp_path / "run" / "evaluation" / "front.csv")
    assert list(front.filter(regex="^return_")) == ["return_right", "return_left"]
    assert front.filter(regex="^reference_").to_numpy()[0].tolist() == [-68.0, -68.0]
    preferences = finished.evaluation.preferences()
    still = finished.evaluation.returns(lambda observation, _: 0 * observation, preferences, 5, 12345).mean(1)
    right, both, left = (front["utility"].to_numpy() / (preferences * still).sum(-1).numpy()).tolist()
    assert max(right, left) < 0.5  # of the loss of who stands still; the best is 0.1
    assert both < 0.9  # 0.75


@pytest.mark.parametrize("target", ["Between", "bounded_by_itself"])
def test_an_environment_or_what_makes_one_serves_and_its_run_continues(target, my_task, tmp_path, monkeypatch, capsys):
    words = (*OWN, *BRIEF, f"env._target_=my_task.{target}", "transforms.time_limit.max_steps=8")
    with monkeypatch.context() as patch:
        interrupt_at(patch, 128)
        assert run(configure(*words), tmp_path / "run") is None
    finished = run(configure(*words, f"resume='{tmp_path / 'run'}'"), tmp_path / "run")
    assert finished.policy.objectives == ("right", "left")
    assert "at 192 of 512 frames" in capsys.readouterr().out


def test_an_environment_without_an_observation_is_refused(my_task, tmp_path):
    with pytest.raises(ValueError, match="must write what it observes as 'observation', not place"):
        run(configure(*OWN, "env._target_=my_task.Blind"), tmp_path / "run")


def test_a_run_of_ones_own_environment_is_trusted_only_on_demand(my_task, tmp_path):
    run(configure(*OWN, *BRIEF, "env._target_=my_task.Between", "trainer.total_frames=64"), tmp_path / "run")
    with pytest.raises(ValueError, match=r"foreign my_task\.Between"):
        Run(tmp_path / "run")
    assert Run(tmp_path / "run", trust=True).policy.objectives == ("right", "left")
