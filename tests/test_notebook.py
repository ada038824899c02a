"""The notebooks run, draw what they show, and are shipped with it."""

import io
import re
from base64 import b64decode
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from PIL import Image

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.fixture
def execute(tmp_path, monkeypatch):
    """Run a notebook in an empty folder, with environment variables."""

    def run(name, **variables):
        for variable, value in {"OMP_NUM_THREADS": 1, **variables}.items():
            monkeypatch.setenv(variable, str(value))
        book = nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=4)
        client = NotebookClient(book, timeout=600, kernel_name="python3", resources={"metadata": {"path": tmp_path}})
        client.execute()
        return book

    return run


def outputs(book, kind=None):
    found = [output for cell in book.cells if cell.cell_type == "code" for output in cell.outputs]
    return found if kind is None else [output.data[kind] for output in found if kind in output.get("data", {})]


def printed(book):
    return "".join(output.text for output in outputs(book) if output.output_type == "stream")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_shipped_with_its_pictures_and_without_complaints(path):
    book = nbformat.read(path, as_version=4)
    assert len(outputs(book, "image/png")) >= 3
    assert not [output for output in outputs(book) if output.get("name") == "stderr" or output.output_type == "error"]
    assert path.stat().st_size < 1_500_000


def test_the_quickstart_trains_a_policy_and_shows_it_driving(execute):
    book = execute("01_quickstart", MORLNAV_FRAMES=256, MORLNAV_DRIVES=1, MORLNAV_SCENES=2)
    assert "22 episodes: 11 preferences in 2 scenes" in printed(book)
    assert len(re.findall(r"v = [\d.]+ m/s", printed(book))) == 3
    pictures = [Image.open(io.BytesIO(b64decode(data))) for data in outputs(book, "image/png")]
    assert [getattr(picture, "n_frames", 1) > 10 for picture in pictures] == [False, True, False]


def test_the_papers_story_is_told_of_any_sweep(execute):
    book = execute("paper", MORLNAV_SWEEP=RESULTS / "two_styles")
    assert len(outputs(book, "image/png")) == 5  # without what a clone is worth
    head, table, *_ = outputs(book, "text/plain")
    assert len(re.findall(r"^\d +our +\d +seed_\d", head, re.MULTILINE)) == 1
    assert re.search(r"our +1 +(100\.0|99\.\d)", table)
    assert "No Fig. 2a: `morlnav-clone noise --output" in printed(book)


def test_parts_solve_foreign_problems(execute):
    book = execute("03_reuse")
    assert len(outputs(book, "image/png")) == 4
    assert float(re.search(r"largest error of the choice: ([\d.]+)", printed(book))[1]) < 0.2


@pytest.mark.parametrize(
    ("run", "sweep"), [("two_styles/seed_0", "missing"), ("default", "three_styles")], ids=["run", "sweep"]
)
def test_one_run_is_looked_into(run, sweep, execute):
    book = execute("04_one_run", MORLNAV_RUN=RESULTS / run, MORLNAV_SWEEP=RESULTS / sweep)
    assert len(outputs(book, "image/png")) == 6
    assert len(outputs(book, "text/html")) == 3
