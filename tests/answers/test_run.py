"""Answers are computed once, kept as they come, and compared by the command with its exit status."""

import json

import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner
from frozen_answers import run as running
from frozen_answers.__main__ import main
from frozen_answers.answer import Answer, read_frozen
from frozen_answers.ground import Grid, Ground
from frozen_answers.inputs import Question
from frozen_answers.run import run

TINY = Grid(np.full((2, 2), 400.0), Affine(30.0, 0.0, 5e5, 0.0, -30.0, 4e6))
REFUSED = {
    name: lambda _folder: Question(Ground((TINY,)), ()) for name in ("ground/tiny-2", "ground/tiny-too")
}
QUICK = list(REFUSED)


@pytest.fixture(autouse=True)
def _refused_cases(request, monkeypatch):
    """Two cases that are refused before the search."""
    if "real_cases" not in request.fixturenames:
        monkeypatch.setattr(running, "all_cases", lambda: REFUSED)
        monkeypatch.setattr("frozen_answers.__main__.all_cases", lambda: REFUSED)


@pytest.fixture
def real_cases():
    """For tests of the cases' names."""


@pytest.fixture
def results(tmp_path):
    return tmp_path / "build" / "now.jsonl"


@pytest.fixture
def command(tmp_path, results):
    """Runs the command with arguments, on a file of frozen answers of its own: exit status, standard output, standard error."""

    def command(*arguments):
        files = "--frozen", str(tmp_path / "answers.jsonl"), "--results", str(results), "--jobs", "1"
        done = CliRunner().invoke(main, [*arguments, *files], catch_exceptions=False)
        return done.exit_code, done.stdout, done.stderr

    return command


def taken(names, results, **how) -> list[str]:
    """The cases that were not computed."""
    kept = []
    run(
        names,
        results,
        jobs=1,
        report=lambda one, again: kept.append(one.found.case) if again else None,
        **how,
    )
    return kept


def test_an_interrupted_run_goes_on(results):
    run(QUICK[:1], results, jobs=1)
    with results.open("a") as file:
        file.write('{"code":"cut off in the midd')
    assert taken(QUICK, results) == QUICK[:1]
    assert taken(QUICK, results) == QUICK
    assert len(results.read_text().splitlines()) == 2


def test_fresh_computes_again(results):
    run(QUICK, results, jobs=1)
    assert taken(QUICK, results, fresh=True) == []


def test_what_other_code_computed_is_not_taken(results, monkeypatch):
    run(QUICK, results, jobs=1)
    monkeypatch.setattr(running, "_DIGEST", ["of other code"])
    assert taken(QUICK, results) == []


def test_a_defect_is_an_answer_and_the_other_cases_go_on(results, monkeypatch):
    def broken(question, folder):
        raise ZeroDivisionError("in the middle of a search")

    monkeypatch.setattr(running, "answers_to", broken)
    found = run(QUICK, results, jobs=1)
    for name in QUICK:
        assert found[name].found.answers == (
            Answer(status="error", reason="ZeroDivisionError: in the middle of a search"),
        )


def test_frozen_answers_are_the_same_when_computed_again(command, results, tmp_path):
    assert command(*QUICK, "--freeze")[0] == 0
    results.unlink()
    status, out, _ = command(*QUICK)
    assert status == 0
    assert "2 of 2 the same" in out
    (first, *_) = read_frozen(tmp_path / "answers.jsonl")["ground/tiny-2"].answers
    assert first == Answer(status="refused", reason="ground-0.tif: 2 x 2 cells are too few to search")


def test_a_difference_is_shown_and_ends_with_1(command, tmp_path):
    command(*QUICK, "--freeze")
    frozen = tmp_path / "answers.jsonl"
    frozen.write_text(frozen.read_text().replace("too few", "too many", 1))
    status, out, _ = command(*QUICK)
    assert status == 1
    assert "ground/tiny-2" in out
    assert "other details" in out
    assert "1 of 2 the same" in out
    status, out, _ = command(*QUICK, "--json")
    assert status == 1
    assert [one["case"] for one in json.loads(out)["different"]] == ["ground/tiny-2"]


def test_freezing_some_keeps_the_others(command, tmp_path):
    command(*QUICK[:1], "--freeze")
    command(*QUICK[1:], "--freeze")
    assert list(read_frozen(tmp_path / "answers.jsonl")) == sorted(QUICK)


def test_a_defect_is_not_frozen(command, monkeypatch, tmp_path):
    def broken(question, folder):
        raise ZeroDivisionError

    monkeypatch.setattr(running, "answers_to", broken)
    status, _, err = command(QUICK[0], "--freeze")
    assert status == 2
    assert "ground/tiny-2: ended in an error of the program" in err
    assert not (tmp_path / "answers.jsonl").exists()


def test_a_kind_selects_its_cases(command, real_cases):
    _, out, _ = command("twins", "drive/hills*", "--list")
    kinds = {line.split("/")[0] for line in out.split()}
    assert kinds == {"twins", "drive"}
    assert "drive/there-and-back" not in out.split()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nothing/*",), "nothing/*: no case has such a name"),
        ((QUICK[0],), "answers.jsonl: no such file; --freeze writes it"),
    ],
)
def test_bad_use_is_said_in_a_line_and_ends_with_2(command, arguments, words):
    status, out, err = command(*arguments)
    assert (status, out) == (2, "")
    assert words in err


def test_a_file_that_holds_no_answers_is_named(command, tmp_path):
    (tmp_path / "answers.jsonl").write_text('{"case":"a"}\n')
    status, _, err = command(QUICK[0])
    assert status == 2
    assert "answers.jsonl" in err
