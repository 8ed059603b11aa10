"""Links that lead nowhere, and what a page would load from elsewhere: ``python -m generate.links SITE``."""

import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote, urlsplit

from markdown_it import MarkdownIt

LOADED = {"script": "src", "img": "src", "source": "src", "iframe": "src", "video": "src", "object": "data"}
"""Elements whose content a browser fetches by itself, by the attribute that names it; of ``link`` see ``_loads``."""
_CSS_URL = re.compile(r"""(?:url\(|@import)\s*["']?((?:https?:)?//[^"')\s]+)""")


@dataclass
class Page:
    """Of one page of the site: what may be linked to, what is linked to, and what is loaded with it."""

    anchors: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.page = Page()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = {name: value or "" for name, value in attrs}
        self.page.anchors.update(named[name] for name in ("id", "name") if name in named)
        if tag == "a" and "href" in named:
            self.page.links.append(named["href"])
        if tag == "link" and _loads(named.get("rel", "")):
            self.page.loaded.append(named.get("href", ""))
        if tag in LOADED and LOADED[tag] in named:
            self.page.loaded.append(named[LOADED[tag]])


def _loads(rel: str) -> bool:
    return not {"index", "search", "next", "prev", "canonical"} & set(rel.split())


def read_page(html: str) -> Page:
    """What there is of links in a page."""
    reader = _Reader()
    reader.feed(html)
    return reader.page


def site_problems(site: Path) -> Iterator[str]:
    """What is wrong with a built site, a line each."""
    pages = {file.resolve(): read_page(file.read_text()) for file in sorted(site.rglob("*.html"))}
    for file, page in pages.items():
        where = file.relative_to(site.resolve())
        for link in [*page.links, *page.loaded]:
            target = urlsplit(link)
            if target.scheme or target.netloc:
                continue
            path = (file.parent / unquote(target.path)).resolve() if target.path else file
            if not path.exists():
                yield f"{where}: {link} leads to no file"
            elif path in pages and target.fragment and unquote(target.fragment) not in pages[path].anchors:
                yield f"{where}: {link} leads to no heading"
        for loaded in page.loaded:
            if urlsplit(loaded).netloc:
                yield f"{where}: loads {loaded} from elsewhere"
    for sheet in sorted(site.rglob("*.css")):
        for url in _CSS_URL.findall(sheet.read_text()):
            yield f"{sheet.relative_to(site)}: loads {url} from elsewhere"


def markdown_problems(root: Path, files: Sequence[Path]) -> Iterator[str]:
    """Links in Markdown files of the repository ``root`` that lead to no file of it, or to no heading of a page."""
    for file in files:
        for link in _markdown_links(file.read_text()):
            target = urlsplit(link)
            if target.scheme or target.netloc:
                continue
            path = (file.parent / unquote(target.path)).resolve() if target.path else file
            if not path.exists() or not path.is_relative_to(root.resolve()):
                yield f"{file.relative_to(root)}: {link} leads to no file of the repository"
            elif (
                target.fragment and path.suffix == ".md" and target.fragment not in headings(path.read_text())
            ):
                yield f"{file.relative_to(root)}: {link} leads to no heading"


def _markdown_links(text: str) -> Iterator[str]:
    for token in MarkdownIt("gfm-like", {"linkify": False}).parse(text):
        for child in token.children or []:
            target = child.attrGet("href") or child.attrGet("src")
            if target:
                yield str(target)


def headings(text: str) -> set[str]:
    """The anchors of a page's headings, as GitHub and MyST name them."""
    found: dict[str, int] = {}
    tokens = MarkdownIt("gfm-like", {"linkify": False}).parse(text)
    for opening, inline in pairwise(tokens):
        if opening.type == "heading_open":
            words = "".join(child.content for child in inline.children or [])
            slug = re.sub(r"[^\w\- ]", "", words.strip().lower()).replace(" ", "-")
            found[slug] = found.get(slug, -1) + 1
            if found[slug]:
                found[f"{slug}-{found[slug]}"] = 0
    return set(found)


def main() -> int:
    """Print what is wrong with the site; status 1 if anything is."""
    problems = list(site_problems(Path(sys.argv[1])))
    for problem in problems:
        print(problem, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
