"""Make the notebook of a guide: its text and code in cells, run from the first to the last (`make notebook`).

The guide is the only source. Where it writes a figure to a file, the notebook shows it.
"""

import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from markdown_it import MarkdownIt
from nbclient import NotebookClient

GUIDE = Path(__file__).parents[1] / "guides" / "python.md"
NOTEBOOK = GUIDE.with_suffix(".ipynb")
INTRODUCTION = re.compile(r" The same steps with their figures are in a\n\[notebook\]\(python\.ipynb\)\.")
SAVED_FIGURE = re.compile(r"^figure\.savefig\(.*\)$", re.MULTILINE)
SHELL = "%%sh\nunset FORCE_COLOR CLICOLOR_FORCE"
"""A notebook sets these; progress bars would then be drawn into its output."""
DOTS_PER_INCH = 72


def unrun(guide: str) -> Any:
    """The notebook of a guide in Markdown, without outputs."""
    lines = INTRODUCTION.sub("", guide).splitlines()
    cells: list[Any] = []
    done = 0

    def add_text(end: int) -> None:
        text = "\n".join(lines[done:end]).strip()
        if text:
            cells.append(nbformat.v4.new_markdown_cell(text))

    for token in MarkdownIt().parse("\n".join(lines)):
        if token.type != "fence" or token.info not in ("python", "sh"):
            continue
        assert token.map is not None
        add_text(token.map[0])
        done = token.map[1]
        code = token.content.strip()
        code = f"{SHELL}\n{code}" if token.info == "sh" else SAVED_FIGURE.sub("plt.show()", code)
        cells.append(nbformat.v4.new_code_cell(code))
    add_text(len(lines))
    notebook = nbformat.v4.new_notebook(cells=cells)
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"  # the same each time
    notebook.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return notebook


def run(notebook: Any, folder: Path) -> None:
    """Run all cells in a folder; they keep their outputs. Raises ``CellExecutionError`` where one fails."""
    commands = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"  # sim and rig for the shell
    resolution = nbformat.v4.new_code_cell(
        f"import matplotlib\nmatplotlib.rcParams['figure.dpi'] = {DOTS_PER_INCH}"
    )
    notebook.cells.insert(0, resolution)
    client = NotebookClient(
        notebook,
        timeout=600,
        startup_timeout=300,
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute(env={**os.environ, "PATH": commands})
    notebook.cells.remove(resolution)
    for count, cell in enumerate((c for c in notebook.cells if c.cell_type == "code"), 1):
        cell.execution_count = count
        cell.metadata.pop("execution", None)  # when it ran
        for output in cell.outputs:
            if "execution_count" in output:
                output["execution_count"] = count
    notebook.metadata.pop("language_info", None)


def main() -> None:
    """Write the notebook."""
    notebook = unrun(GUIDE.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        run(notebook, Path(folder))
    nbformat.validate(notebook)
    NOTEBOOK.write_text(nbformat.writes(notebook) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
