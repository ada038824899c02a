"""Every part is swapped from a foreign package by a word or two on the command line, and is at work in the run."""

import re
import shlex
from pathlib import Path

import pytest
from support import ANALYTICAL, BRIEF

import morlnav
from morlnav.commands.evaluate import use_world
from morlnav.navigation.world import PymunkWorld
from morlnav.runs import Run

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "extending.md").read_text()
ROWS = re.findall(r"^\| ([^|]+) \| `([^|]+)` \| `(\w+)` \|", PAGE, re.MULTILINE)
SMOKE = ("trainer=smoke", "threads=1", "trainer.progress_bar=false", "replay.storage.max_size=4096")
TINY = ("trainer.total_frames=128", "evaluation.episodes=2", "evaluation.steps=1", "env.scenes.distance=[5,6]")
LEARNED = (*BRIEF, "rewards.clone.fit.steps=2", "rewards.ranking.fit.steps=2", "cache=null", "trainer.total_frames=128")


def swaps(learned):
    return [row for row in ROWS if ("rewards." in row[1]) is learned]


def groups(rows):
    """Rows that go into one run: none of them sets a part that another one sets."""
    runs = []
    for row in rows:
        keys = {word.lstrip("+").split("._target_")[0].split("=")[0] for word in shlex.split(row[1])}
        for taken, members in runs:
            if not any(_overlap(key, other) for key in keys for other in taken):
                taken |= keys
                members.append(row)
                break
        else:
            runs.append((set(keys), [row]))
    return [members for _, members in runs]


def _overlap(key, other):
    return f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.")


def test_the_page_tells_every_part_of_the_package():
    sources = [path.read_text() for path in (Path(__file__).parent / "swapper").glob("*.py")]
    parts = {name for text in sources for name in re.findall(r"^(?:class|def) (\w+)", text, re.MULTILINE)} - {"mark"}
    assert {mark for _, _, mark in ROWS} == parts


@pytest.mark.parametrize("rows", groups(swaps(False)), ids=lambda rows: ",".join(row[2] for row in rows))
def test_a_part_of_ones_own_is_at_work(rows, used, train_command):
    words = [word for _, line, _ in rows for word in shlex.split(line)]
    start = () if any(word.startswith("objectives=") for word in words) else (ANALYTICAL,)
    train_command(*SMOKE, *TINY, *start, *words, "hydra.run.dir=run")
    assert {mark for _, _, mark in rows} <= used


def test_what_was_trained_in_a_world_of_ones_own_is_evaluated_in_another(used, train_command):
    train_command(*SMOKE, *TINY, ANALYTICAL, *shlex.split(ROWS[1][1]), "env.world.step_time=0.25", "hydra.run.dir=run")
    assert used == {"SlipperyWorld"}
    use_world(run := Run("run", trust=True), "pymunk")
    assert type(run.evaluation.env.world) is PymunkWorld
    assert run.evaluation.env.world.step_time == 0.25


@pytest.mark.parametrize("rows", groups(swaps(True)), ids=lambda rows: ",".join(row[2] for row in rows))
def test_a_part_of_ones_own_is_at_work_where_rewards_are_learned(rows, used, train_command):
    words = [word for _, line, _ in rows for word in shlex.split(line)]
    train_command(*SMOKE, *LEARNED, *words, "hydra.run.dir=run")
    assert {mark for _, _, mark in rows} <= used


FILES = dict(re.findall(r'^```yaml title="my_conf/([^"]+)"\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE))


def test_one_file_of_ones_own_replaces_seven_parts_at_once(used, train_command, tmp_path):
    assert len(FILES["recipe/mine.yaml"].splitlines()) <= 17
    for name, text in FILES.items():
        (tmp_path / "my_conf" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "my_conf" / name).write_text(text)
    words = shlex.split(re.findall(r"^morlnav-train (.*recipe=mine.*)$", PAGE, re.MULTILINE)[0])
    train_command(*words, *SMOKE, *TINY)
    assert {"Corridor", "StraightLoss", "Lines", "Shaky", "Recent", "Halved", "Count", "Calm"} <= used
    with pytest.raises(ValueError, match=r"foreign swapper\."):
        Run(tmp_path / "outputs" / "mine")
    assert morlnav.load("outputs/mine", trust=True).objectives == ("distance", "calm")


def test_the_code_of_the_page_runs(used):
    code = re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    exec("\n".join(block for block in code if "outputs/mine" not in block), {})
