"""The scores of the modules, the explanations of what survived, and the page that shows both."""

import json
import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path

from mutate.result import Result, source_digest

GOAL = 0.85
EQUIVALENT = "equivalent:"
"""An explanation that begins so says that the mutant behaves as the module does: no test can notice it."""
BEGIN, END = "<!-- scores: written by make mutate -->", "<!-- end of scores -->"


@dataclass(frozen=True)
class Score:
    """What the last trial of a module showed."""

    source: str
    """Digest of the module that was tried."""
    mutants: int
    tried: int
    survivors: list[str]
    cpu_s: float


@dataclass(frozen=True)
class Book:
    """The files in `tests/mutation`."""

    folder: Path

    @property
    def root(self) -> Path:
        return self.folder.parents[1]

    def modules(self) -> dict[str, list[str]]:
        """The tests (files or folders) of each module that is tried."""
        groups: list[dict[str, list[str]]] = tomllib.loads((self.folder / "modules.toml").read_text())[
            "group"
        ]
        return {module: group["tests"] for group in groups for module in sorted(group["modules"])}

    def explanations(self) -> dict[str, dict[str, str]]:
        """Why a mutant survives, by module and by the mutant's name."""
        return tomllib.loads((self.folder / "survivors.toml").read_text())

    def scores(self) -> dict[str, Score]:
        read = json.loads((self.folder / "scores.json").read_text())
        return {module: Score(**score) for module, score in read.items()}

    def score(self, result: Result) -> Score:
        digest = source_digest(self.root / result.module)
        return Score(digest, result.mutants, result.tried, list(result.survivors), round(result.cpu_s))

    def keep(self, module: str, score: Score) -> None:
        known = self.modules()
        scores = {name: asdict(kept) for name, kept in self.scores().items() if name in known}
        scores[module] = asdict(score)
        text = json.dumps(dict(sorted(scores.items())), indent=1, ensure_ascii=False)
        (self.folder / "scores.json").write_text(text + "\n")

    def stale(self) -> list[str]:
        """The modules that have changed since their score was measured, or have none."""
        scores = self.scores()
        return [
            module
            for module in self.modules()
            if module not in scores or scores[module].source != source_digest(self.root / module)
        ]


def share_noticed(score: Score, explanations: dict[str, str]) -> float:
    """Share of the mutants that a test noticed, of those that are not equivalent to the module."""
    equivalent = _equivalent(score, explanations)
    different = score.tried - equivalent
    return 1.0 - (len(score.survivors) - equivalent) / different if different else 1.0


def unexplained(score: Score, explanations: dict[str, str]) -> list[str]:
    return [name for name in score.survivors if name not in explanations]


def _equivalent(score: Score, explanations: dict[str, str]) -> int:
    return sum(explanations.get(name, "").startswith(EQUIVALENT) for name in score.survivors)


def table(book: Book) -> str:
    """The scores as a table of the page."""
    lines = [
        "| module | mutants tried | noticed | survivors: equivalent, explained, open |",
        "| --- | ---: | ---: | --- |",
    ]
    explanations = book.explanations()
    stale = book.stale()
    for module, score in sorted(book.scores().items()):
        own = explanations.get(module, {})
        equivalent = _equivalent(score, own)
        open_ones = len(unexplained(score, own))
        tried = f"{score.tried}" if score.tried == score.mutants else f"{score.tried} of {score.mutants}"
        lines.append(
            f"| `{module}` | {tried} | {share_noticed(score, own):.0%}"
            f"{' (of an older version)' if module in stale else ''} | "
            f"{equivalent}, {len(score.survivors) - equivalent - open_ones}, {open_ones} |"
        )
    return "\n".join(lines)


def write_page(book: Book, page: Path) -> None:
    """Put the table where the page has room for it."""
    before, _, rest = page.read_text().partition(BEGIN)
    after = rest.partition(END)[2]
    page.write_text(f"{before}{BEGIN}\n\n{table(book)}\n\n{END}{after}")
