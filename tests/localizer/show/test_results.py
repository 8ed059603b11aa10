"""Files of a result: a bad name is refused before any picture is read."""

from pathlib import Path
from unittest.mock import Mock

import pytest

import localizer

NOTHING = Mock(spec=[])  # whatever is asked of it is an error


def test_a_figure_of_no_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(localizer.SkyfixError, match=r"^file: .*fix\.txt: no picture format"):
        localizer.save_figure(tmp_path / "fix.txt", NOTHING, NOTHING, NOTHING)


def test_a_report_where_a_file_is_is_refused(tmp_path: Path) -> None:
    (tmp_path / "report").touch()
    with pytest.raises(localizer.SkyfixError, match=r"^folder: .*report: is a file; name a folder"):
        localizer.save_report(tmp_path / "report", NOTHING, NOTHING, NOTHING)
