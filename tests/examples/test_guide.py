"""The Python code in the guides runs, each page from its first block to its last."""

from pathlib import Path

import pytest
from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
GUIDES = [README, ROOT / "docs" / "guides" / "python.md"]


@pytest.mark.long
@pytest.mark.parametrize("guide", GUIDES, ids=lambda guide: guide.stem)
def test_the_code_in_a_guide_runs(
    guide: Path, in_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if guide == README:  # captures a bundle of its own
        monkeypatch.chdir(tmp_path)
    text = guide.read_text(encoding="utf-8")
    blocks = [token for token in MarkdownIt().parse(text) if token.type == "fence" and token.info == "python"]
    assert blocks
    names: dict[str, object] = {"__name__": guide.stem}
    for block in blocks:
        assert block.map is not None
        first_line = block.map[0] + 1
        exec(compile("\n" * first_line + block.content, str(guide), "exec"), names)
