"""The small faults that are put into a module, one at a time: found in its syntax tree, made as edits of its text."""

import ast
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

ARITHMETIC: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "//"),
    ast.Pow: ("**", "*"),
    ast.LShift: ("<<", ">>"),
    ast.RShift: (">>", "<<"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
    ast.BitXor: ("^", "&"),
}
NEGATED: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: ("<", ">="),
    ast.LtE: ("<=", ">"),
    ast.Gt: (">", "<="),
    ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}
BOUNDARY: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
}
OTHER_FUNCTION = {
    "min": "max",
    "max": "min",
    "any": "all",
    "all": "any",
    "sin": "cos",
    "cos": "sin",
    "floor": "ceil",
    "ceil": "floor",
    "minimum": "maximum",
    "maximum": "minimum",
    "nanmin": "nanmax",
    "nanmax": "nanmin",
    "argmin": "argmax",
    "argmax": "argmin",
    "radians": "degrees",
    "degrees": "radians",
    "median": "max",
    "mean": "max",
}
LEFT_OUT_FUNCTION = {"abs", "sqrt", "round", "absolute"}
LOGGED = {"log", "logger", "warnings"}
LARGE = 10
"""An integer from here on is taken for a limit and multiplied by ten; a smaller one is counted one up."""


@dataclass(frozen=True)
class Mutant:
    """One fault: `text[start:end]` of the module becomes `new`."""

    function: str
    """Qualified name of the function or class that it is in; empty at the top of the module."""
    line: int
    last_line: int
    """The statement's or expression's first and last line: a test that runs one of them may notice."""
    start: int
    end: int
    new: str
    before: str
    """The line as it was, without indentation."""
    after: str
    """The line with the fault."""
    at_import: bool
    """It runs when the module is imported, so which tests it matters to is not seen from its line."""
    number: int = 1
    """Tells mutants apart that look the same."""

    @property
    def name(self) -> str:
        """What it is called in scores and explanations: stays the same as long as the line does."""
        again = f" ({self.number})" if self.number > 1 else ""
        return f"{self.function or 'module'}: {self.before}  ->  {self.after}{again}"

    def applied(self, text: str) -> str:
        """The module's text with the fault."""
        return text[: self.start] + self.new + text[self.end :]


def mutants_of(text: str) -> list[Mutant]:
    """All mutants of a module's text that compile, in the order of the text.

    Raises SyntaxError if the module itself does not compile.
    """
    found: list[Mutant] = []
    counted: Counter[str] = Counter()
    for mutant in sorted(_Search(text).run(), key=lambda mutant: (mutant.start, mutant.end, mutant.new)):
        try:
            ast.parse(mutant.applied(text))
        except SyntaxError:
            continue
        counted[mutant.name] += 1
        found.append(replace(mutant, number=counted[mutant.name]))
    return found


class _Search:
    """Walks the syntax tree and keeps what is around the node that it stands at."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.lines = text.splitlines(keepends=True)
        self.starts = [0]
        for line in self.lines:
            self.starts.append(self.starts[-1] + len(line))
        self.names: list[str] = []
        self.in_function = 0

    def run(self) -> Iterator[Mutant]:
        yield from self.body(ast.parse(self.text).body)

    # Where things stand in the text.

    def offset(self, line: int, column_bytes: int) -> int:
        line_text = self.lines[line - 1]
        return self.starts[line - 1] + len(line_text.encode()[:column_bytes].decode())

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self.offset(node.lineno, node.col_offset), self.offset(node.end_lineno, node.end_col_offset)

    def edit(self, node: ast.expr | ast.stmt, start: int, end: int, new: str) -> Mutant:
        line_number = self.text.count("\n", 0, start) + 1
        line_start = self.starts[line_number - 1]
        line = self.lines[line_number - 1].rstrip("\n")
        cut = min(end, line_start + len(line))
        after = line[: start - line_start] + new + line[cut - line_start :]
        return Mutant(
            function=".".join(self.names),
            line=node.lineno,
            last_line=node.end_lineno or node.lineno,
            start=start,
            end=end,
            new=new,
            before=line.strip(),
            after=after.strip(),
            at_import=not self.in_function,
        )

    def whole(self, node: ast.expr | ast.stmt, new: str) -> Mutant:
        return self.edit(node, *self.span(node), new)

    def between(
        self, node: ast.expr, left: ast.expr, right: ast.expr, old: str, new: str
    ) -> Iterator[Mutant]:
        """Mutant whose operator `old`, which stands between two operands, is `new`."""
        after_left, before_right = self.span(left)[1], self.span(right)[0]
        at = self.text.find(old, after_left, before_right)
        if at >= 0:
            yield self.edit(node, at, at + len(old), new)

    # Statements.

    def body(self, statements: list[ast.stmt]) -> Iterator[Mutant]:
        for statement in statements:
            yield from self.statement(statement)

    def statement(self, node: ast.stmt) -> Iterator[Mutant]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from self.expressions([*node.args.defaults, *filter(None, node.args.kw_defaults)])
            self.names.append(node.name)
            self.in_function += 1
            yield from self.body(node.body)
            self.in_function -= 1
            self.names.pop()
        elif isinstance(node, ast.ClassDef):
            self.names.append(node.name)
            yield from self.body(node.body)
            self.names.pop()
        elif isinstance(
            node, ast.Import | ast.ImportFrom | ast.Raise | ast.Assert | ast.Global | ast.Nonlocal
        ):
            return  # what a message says is not a behaviour
        elif isinstance(node, ast.AnnAssign):
            if node.value is not None:
                yield from self.expression(node.value)
        elif isinstance(node, ast.Expr):
            yield from self.lone_expression(node)
        elif isinstance(node, ast.If):
            yield from self.condition(node)
        elif isinstance(node, ast.Assign) and not self.in_function and not _is_value(node.value):
            return  # an alias of a type
        else:
            if isinstance(node, ast.AugAssign) and self.in_function:
                yield self.whole(node, "pass")
            for child in ast.iter_child_nodes(node):
                yield from self.any_child(child)

    def any_child(self, node: ast.AST) -> Iterator[Mutant]:
        if isinstance(node, ast.stmt):
            yield from self.statement(node)
        elif isinstance(node, ast.expr):
            yield from self.expression(node)
        elif isinstance(node, ast.ExceptHandler):
            yield from self.body(node.body)
        elif isinstance(node, ast.match_case):
            yield from self.expressions([node.guard] if node.guard else [])
            yield from self.body(node.body)
        elif isinstance(node, ast.withitem):
            yield from self.expression(node.context_expr)

    def lone_expression(self, node: ast.Expr) -> Iterator[Mutant]:
        value = node.value.value if isinstance(node.value, ast.Await) else node.value
        if isinstance(value, ast.Constant) or (isinstance(value, ast.Call) and _root(value.func) in LOGGED):
            return
        if isinstance(value, ast.Call) and self.in_function:
            yield self.whole(node, "pass")
        yield from self.expression(value)

    def condition(self, node: ast.If) -> Iterator[Mutant]:
        if _root(node.test) == "TYPE_CHECKING":
            return
        leaves = isinstance(node.body[-1], ast.Raise | ast.Return | ast.Continue | ast.Break)
        if leaves or not node.orelse:
            yield self.whole(node.test, "False")
            yield from self.expression(node.test, negate=False)
        else:
            yield from self.expression(node.test)
        yield from self.body(node.body)
        yield from self.body(node.orelse)

    # Expressions.

    def expressions(self, nodes: list[ast.expr]) -> Iterator[Mutant]:
        for node in nodes:
            yield from self.expression(node)

    def expression(self, node: ast.expr, *, negate: bool = True) -> Iterator[Mutant]:
        if isinstance(node, ast.BinOp):
            old, new = ARITHMETIC.get(type(node.op), ("", ""))
            if old and not (isinstance(node.left, ast.Constant | ast.JoinedStr) and _is_text(node.left)):
                yield from self.between(node, node.left, node.right, old, new)
        elif isinstance(node, ast.Compare):
            yield from self.comparison(node, negate=negate)
        elif isinstance(node, ast.BoolOp):
            old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
            for left, right in zip(node.values, node.values[1:], strict=False):
                yield from self.between(node, left, right, old, new)
        elif isinstance(node, ast.UnaryOp):
            yield from self.unary(node, negate=negate)
        elif isinstance(node, ast.Constant):
            yield from self.constant(node)
        elif isinstance(node, ast.Call):
            yield from self.call(node)
        elif isinstance(node, ast.Attribute) and node.attr == "T":
            end = self.span(node)[1]
            yield self.edit(node, end - len(".T"), end, "")
        elif isinstance(node, ast.Subscript):
            yield from self.subscript(node)
            return
        elif isinstance(node, ast.Lambda):
            yield from self.expression(node.body)
            return
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.expr):
                yield from self.expression(child)
            elif isinstance(child, ast.keyword):
                yield from self.expression(child.value)
            elif isinstance(child, ast.comprehension):
                yield from self.expressions([child.iter, *child.ifs])

    def comparison(self, node: ast.Compare, *, negate: bool) -> Iterator[Mutant]:
        operands = [node.left, *node.comparators]
        for left, operator, right in zip(operands, node.ops, operands[1:], strict=False):
            if negate:
                yield from self.between(node, left, right, *NEGATED[type(operator)])
            # Of two measured values none is ever exactly at the limit; of counts one is.
            if type(operator) in BOUNDARY and (_is_count(left) or _is_count(right)):
                yield from self.between(node, left, right, *BOUNDARY[type(operator)])

    def unary(self, node: ast.UnaryOp, *, negate: bool) -> Iterator[Mutant]:
        symbol = {ast.Not: "not", ast.USub: "-"}.get(type(node.op))
        if symbol is not None and (negate or symbol != "not"):
            start = self.span(node)[0]
            yield self.edit(node, start, start + len(symbol), "")

    def constant(self, node: ast.Constant) -> Iterator[Mutant]:
        value = node.value
        if isinstance(value, bool):
            yield self.whole(node, repr(not value))
        elif isinstance(value, float):
            yield self.whole(node, repr(10 * value) if value else "1.0")
        elif isinstance(value, int):
            start, end = self.span(node)
            if self.text[start:end].lower().startswith("0x"):
                yield self.whole(node, hex(value << 1 if value else 1))
            else:
                yield self.whole(node, repr(10 * value if value >= LARGE else value + 1))
        elif isinstance(value, bytes) and value:
            yield self.whole(node, repr(bytes([value[0] ^ 1]) + value[1:]))

    def call(self, node: ast.Call) -> Iterator[Mutant]:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        end = self.span(node.func)[1]
        if name in OTHER_FUNCTION:
            yield self.edit(node, end - len(name), end, OTHER_FUNCTION[name])
        elif name in LEFT_OUT_FUNCTION and len(node.args) == 1:
            yield self.whole(node, f"({self.text[slice(*self.span(node.args[0]))]})")
        elif name == "arctan2" and len(node.args) == 2:
            first, second = (self.text[slice(*self.span(argument))] for argument in node.args)
            yield self.edit(
                node, self.span(node.args[0])[0], self.span(node.args[1])[1], f"{second}, {first}"
            )

    def subscript(self, node: ast.Subscript) -> Iterator[Mutant]:
        yield from self.expression(node.value)
        if _root(node.value) != "Literal":
            for part in ast.walk(node.slice):
                if isinstance(part, ast.Constant) and type(part.value) is int:
                    yield self.whole(part, repr(part.value + 1))


def _root(node: ast.expr) -> str:
    """Name that an expression such as `log.bind(x).info` starts with."""
    while isinstance(node, ast.Attribute | ast.Call | ast.Subscript):
        node = node.func if isinstance(node, ast.Call) else node.value
    return node.id if isinstance(node, ast.Name) else ""


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _is_count(node: ast.expr) -> bool:
    is_length = isinstance(node, ast.Call) and getattr(node.func, "id", "") == "len"
    return is_length or (isinstance(node, ast.Constant) and type(node.value) is int)


def _is_value(node: ast.expr) -> bool:
    """Whether what is assigned at the top of a module is a value, not a type such as `int | None`."""
    return not (isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr)) and _root(node) not in {
        "Literal",
        "Annotated",
        "TypeVar",
    }
