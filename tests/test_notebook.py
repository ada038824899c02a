from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "results" / "default"


@pytest.fixture
def trained_run(request):
    return KEPT if (KEPT / "policy.pt").is_file() else request.getfixturevalue("smoke_run")


def test_the_notebook_runs_and_draws(trained_run, tmp_path, monkeypatch):
    monkeypatch.setenv("MORLNAV_RUN", str(trained_run))
    monkeypatch.setenv("MORLNAV_SWEEP", str(tmp_path / "missing"))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    notebook = nbformat.read(ROOT / "notebooks" / "analysis.ipynb", as_version=4)
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 6
    assert sum("text/html" in output.get("data", {}) for output in outputs) == 3
