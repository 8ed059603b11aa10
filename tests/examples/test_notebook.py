"""The notebook beside the guide says what the guide says, with figures, and runs in an empty folder."""

import importlib.util
from pathlib import Path
from types import ModuleType

import nbformat
import pytest

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "docs" / "guides" / "python.md"
NOTEBOOK = GUIDE.with_suffix(".ipynb")
LARGEST_BYTES = 400_000


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    """The program that makes the notebook."""
    spec = importlib.util.spec_from_file_location(
        "notebook_maker", ROOT / "docs" / "generate" / "notebook.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_notebook_is_that_of_the_guide(maker: ModuleType) -> None:
    kept = nbformat.reads(NOTEBOOK.read_text(encoding="utf-8"), as_version=4)
    made = maker.unrun(GUIDE.read_text(encoding="utf-8"))
    cells = [[(cell.cell_type, cell.source) for cell in notebook.cells] for notebook in (kept, made)]
    assert cells[0] == cells[1], "make notebook"


def test_the_notebook_has_its_figures_and_is_small() -> None:
    text = NOTEBOOK.read_text(encoding="utf-8")
    assert text.count('"image/png"') == GUIDE.read_text(encoding="utf-8").count("figure.savefig(")
    assert len(text.encode()) < LARGEST_BYTES
    assert "/tmp" not in text


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_notebook_runs_from_the_first_cell_to_the_last(
    maker: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path / "runtime"))
    notebook = maker.unrun(GUIDE.read_text(encoding="utf-8"))
    maker.run(notebook, tmp_path)
    written = [
        output["text"]
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if output["output_type"] == "stream"
    ]
    assert any(text.startswith("fix with probability") for text in written)
