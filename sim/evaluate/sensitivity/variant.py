"""A copy of the package ``localizer`` in which one constant has another value.

Assigning to a module's attribute would not do: constants are imported by value into other modules, stand in default arguments,
and are compiled into kernels. In a copy of the source, imported by a process of its own, the changed value reaches all of them.
"""

import ast
import shutil
from pathlib import Path

import localizer
from sim.errors import SimulationError
from sim.evaluate.sensitivity.constants import Kind, Tuned

_EXPRESSIONS: dict[Kind, str] = {
    "scale": "({value}) * {factor}",
    "complement": "1.0 - (1.0 - ({value})) * {factor}",
    "count": "max(1, round(({value}) * {factor}))",
    "first": "(({value})[0] * {factor}, *({value})[1:])",
    "all": "tuple(each * {factor} for each in ({value}))",
}


def copy_localizer(folder: Path, source: Path | None = None) -> Path:
    """Copy the package ``localizer`` with its compiled kernels into ``folder``, which then goes on ``sys.path``.

    ``source``: a folder that holds such a copy; the installed package without it.
    """
    package = Path(localizer.__file__).parent if source is None else source / "localizer"
    # times are kept: by them numba and Python tell whether what is compiled is still valid
    shutil.copytree(package, folder / "localizer", copy_function=shutil.copy2)
    return folder


def change_constant(folder: Path, tuned: Tuned, factor: float) -> None:
    """Change one constant in a copy of the package.

    Raises:
        SimulationError: the module assigns no such constant, once and at its top level.
    """
    path = folder / "localizer" / "search" / Path(*tuned.module.split(".")).with_suffix(".py")
    text = path.read_text(encoding="utf-8")
    node = _value_of(ast.parse(text), tuned)
    value = ast.get_source_segment(text, node)
    assert value is not None
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    lines = text.splitlines(keepends=True)
    before = "".join([*lines[: node.lineno - 1], lines[node.lineno - 1][: node.col_offset]])
    after = "".join([lines[node.end_lineno - 1][node.end_col_offset :], *lines[node.end_lineno :]])
    path.write_text(
        before + _EXPRESSIONS[tuned.kind].format(value=value, factor=factor) + after, encoding="utf-8"
    )


def _value_of(tree: ast.Module, tuned: Tuned) -> ast.expr:
    found = [
        statement.value
        for statement in tree.body
        if isinstance(statement, ast.Assign)
        for target in statement.targets
        if isinstance(target, ast.Name) and target.id == tuned.name
    ]
    if len(found) != 1:
        raise SimulationError(
            f"localizer.search.{tuned.module} assigns {tuned.name} {len(found)} times, not once"
        )
    return found[0]
