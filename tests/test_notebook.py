from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"


@pytest.mark.parametrize(
    ("run", "sweep"), [("default", "missing"), ("two_objectives/seed_0", "two_objectives")], ids=["run", "sweep"]
)
def test_the_notebook_runs_and_draws(run, sweep, tmp_path, monkeypatch):
    monkeypatch.setenv("MORLNAV_RUN", str(RESULTS / run))
    monkeypatch.setenv("MORLNAV_SWEEP", str(RESULTS / sweep))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    notebook = nbformat.read(ROOT / "notebooks" / "analysis.ipynb", as_version=4)
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 6
    assert sum("text/html" in output.get("data", {}) for output in outputs) == 3
