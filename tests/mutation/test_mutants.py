"""The faults that `make mutate` puts in, and what it makes of a module's tests."""

from pathlib import Path

import pytest
from mutate.mutants import mutants_of
from mutate.score import Book, Score, share_noticed, unexplained
from mutate.trial import try_modules


def faults(text: str) -> set[str]:
    return {mutant.after for mutant in mutants_of(text)}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("LIMIT_M = 4.0", {"LIMIT_M = 40.0"}),
        ("TRIES = 5", {"TRIES = 6"}),
        ("LARGEST = 40", {"LARGEST = 400"}),
        ("BUSY = 0x08", {"BUSY = 0x10"}),
        ("STRICT = True", {"STRICT = False"}),
        ("COMMAND = b'ab'", {"COMMAND = b'`b'"}),
        ("def f(a, b):\n    return a - b", {"return a + b"}),
        ("def f(a, b):\n    return (a) * (b)", {"return (a) / (b)"}),
        ("def f(a, b):\n    return a < b", {"return a >= b"}),
        (
            "def f(a):\n    return len(a) < 3",
            {"return len(a) >= 3", "return len(a) <= 3", "return len(a) < 4"},
        ),
        ("def f(a, b):\n    return a and b", {"return a or b"}),
        ("def f(a):\n    return -a", {"return a"}),
        ("def f(a):\n    if a:\n        return a\n    return None", {"if False:"}),
        ("def f(a):\n    sync(a)", {"pass"}),
        ("def f(a):\n    a += b", {"pass"}),
        ("def f(a):\n    return math.radians(a)", {"return math.degrees(a)"}),
        ("def f(a, b):\n    return np.arctan2(a, b)", {"return np.arctan2(b, a)"}),
        ("def f(a, b):\n    return a @ b.T", {"return a @ b"}),
        ("def f(a):\n    return a[0]", {"return a[1]"}),
        ("def f(a):\n    raise ValueError(f'{a + 1} of 3')", set()),
        ("def f(a):\n    '''Doc.'''\n    log.info('a', n=3)", set()),
        ("Place = float | None", set()),
    ],
)
def test_puts_in_the_faults_that_people_make(text: str, expected: set[str]) -> None:
    assert faults(text) == expected


def test_a_mutant_changes_one_place_and_compiles() -> None:
    text = "def größe(a, b):\n    return 'ä' + str(a - b), a - b\n"
    for mutant in mutants_of(text):
        compile(mutant.applied(text), "mutant", "exec")
        assert len(mutant.applied(text)) == len(text) - (mutant.end - mutant.start) + len(mutant.new)


def test_mutants_of_equal_look_have_names_of_their_own() -> None:
    names = [mutant.name for mutant in mutants_of("def f(a):\n    a += 1\n    a += 1\n")]
    assert len(names) == len(set(names)) == 4


def test_equivalent_mutants_do_not_count_and_explained_ones_do() -> None:
    score = Score(source="", mutants=12, tried=12, survivors=["a", "b", "c"], cpu_s=1)
    explanations = {"a": "equivalent: the same value", "b": "only the speed differs"}
    assert share_noticed(score, explanations) == pytest.approx(1 - 2 / 11)
    assert unexplained(score, explanations) == ["c"]


def test_the_listed_modules_and_tests_are_there() -> None:
    book = Book(Path(__file__).parent)
    for module, tests in book.modules().items():
        assert (book.root / module).is_file(), module
        for test in tests:
            assert (book.root / test).exists(), test
    assert set(book.explanations()) <= set(book.modules())


@pytest.mark.long
def test_tells_a_test_that_notices_from_one_that_does_not(tmp_path: Path) -> None:
    root = tmp_path / "project"
    for folder in ("rig", "localizer", "sim", "tests", "configs", "docs", "systemd"):
        (root / folder).mkdir(parents=True)
    for file in ("README.md", "Makefile", "sim/pytest_plugin.py", "rig/__init__.py", "sim/__init__.py"):
        (root / file).write_text("")
    (root / "pyproject.toml").write_text("[tool.pytest.ini_options]\naddopts = '--import-mode=importlib'\n")
    (root / "rig/sizes.py").write_text(
        "def area(a, b):\n    return a * b\n\n\ndef length(a, b):\n    return a + b\n"
    )
    (root / "tests/test_sizes.py").write_text(
        "from rig.sizes import area, length\n\n\n"
        "def test_area():\n    assert area(2, 3) == 6\n\n\ndef test_length():\n    assert length(2, 0) == 2\n"
    )
    modules = {"rig/sizes.py": ["tests/test_sizes.py"]}
    (result,) = try_modules(root, tmp_path / "work", modules, most=None, jobs=1)
    assert (result.mutants, result.tried, result.refused) == (2, 2, "")
    assert result.survivors == ("length: return a + b  ->  return a - b",)
