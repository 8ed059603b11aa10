"""Write all that is committed of the reference and comes from the code: ``make reference``."""

from pathlib import Path

from generate.commands import commands_page
from generate.configuration import configuration_page
from generate.formats import formats_page
from generate.schemas import DOCUMENTS

DOCS = Path(__file__).resolve().parents[1]


def generated_files() -> dict[Path, str]:
    """The files and what should be in them."""
    files = {
        DOCS / "reference" / "commands.md": commands_page(),
        DOCS / "reference" / "configuration.md": configuration_page(),
        DOCS / "reference" / "formats.md": formats_page(),
    }
    return files | {DOCS / "schemas" / document.file: document.schema_text() for document in DOCUMENTS}


def main() -> None:
    """Write what is not there yet, or is otherwise."""
    for file, text in generated_files().items():
        if not file.exists() or file.read_text() != text:
            file.parent.mkdir(exist_ok=True)
            file.write_text(text)
            print(file.relative_to(DOCS.parent))


if __name__ == "__main__":
    main()
