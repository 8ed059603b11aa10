"""Links of the repository's pages and of the site lead somewhere, and nothing is loaded from elsewhere."""

import subprocess
from pathlib import Path

import pytest
from generate.links import headings, markdown_problems, read_page, site_problems

ROOT = Path(__file__).parents[2]


def pages() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "-z", "*.md"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode:
        pytest.skip("this is no git checkout")
    return [ROOT / name for name in listed.stdout.split("\0") if name and (ROOT / name).exists()]


def test_every_link_in_a_page_leads_to_a_file_and_a_heading() -> None:
    files = pages()
    assert ROOT / "README.md" in files
    assert list(markdown_problems(ROOT, files)) == []


@pytest.mark.parametrize(
    ("link", "problem"),
    [
        ("other.md", None),
        ("other.md#a-head-line", None),
        ("https://example.org/x", None),
        ("#here", None),
        ("none.md", "no file"),
        ("other.md#none", "no heading"),
        ("../outside.md", "no file of the repository"),
    ],
)
def test_links_in_markdown(tmp_path: Path, link: str, problem: str | None) -> None:
    root = tmp_path / "repository"
    root.mkdir()
    (tmp_path / "outside.md").write_text("# Out\n")
    (root / "other.md").write_text("# A `head` line!\n")
    page = root / "page.md"
    page.write_text(f"# Here\n\nSee [it]({link}).\n\n```\n[not](a-link.md)\n```\n")
    found = list(markdown_problems(root, [page]))
    assert (found == []) if problem is None else (len(found) == 1 and problem in found[0])


def test_headings_of_the_same_words_are_numbered() -> None:
    assert headings("# One two\n\n## One two\n\ntext\n\n## `rig run`: x\n") == {
        "one-two",
        "one-two-1",
        "rig-run-x",
    }


def test_a_site_that_is_whole_has_no_problems(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<link rel="stylesheet" href="s.css"><a href="b.html#x">b</a><a href="https://e.org">e</a>'
    )
    (tmp_path / "b.html").write_text('<h1 id="x">b</h1>')
    (tmp_path / "s.css").write_text("body { background: url(data:image/png;base64,AA) }")
    assert list(site_problems(tmp_path)) == []


@pytest.mark.parametrize(
    "html",
    [
        '<a href="none.html">x</a>',
        '<a href="#none">x</a>',
        '<img src="none.png">',
        '<script src="https://cdn.example.org/x.js"></script>',
        '<link rel="stylesheet" href="//fonts.example.org/x.css">',
        '<img src="https://example.org/x.png">',
    ],
)
def test_a_site_that_lacks_or_loads_something(tmp_path: Path, html: str) -> None:
    (tmp_path / "a.html").write_text(html)
    assert len(list(site_problems(tmp_path))) == 1


def test_a_style_sheet_that_loads_a_font(tmp_path: Path) -> None:
    (tmp_path / "s.css").write_text("@font-face { src: url('https://fonts.example.org/f.woff2') }")
    assert list(site_problems(tmp_path)) == ["s.css: loads https://fonts.example.org/f.woff2 from elsewhere"]


def test_what_a_page_holds() -> None:
    page = read_page('<p id="a"><a name="b" href="c.html">c</a><link rel="next" href="d.html"></p>')
    assert (page.anchors, page.links, page.loaded) == ({"a", "b"}, ["c.html"], [])
