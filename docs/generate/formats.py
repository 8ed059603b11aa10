"""The page of the documents that programs exchange: every field with its type, unit and meaning."""

from generate.fields import Schema, field_rows
from generate.markdown import GENERATED, code, from_docstring, table
from generate.schemas import DOCUMENTS, Document, objects_of

INTRODUCTION = """\
Programs exchange four documents, all of them JSON in UTF-8. Each names itself and its version in `schema`. For each there
is a [JSON Schema](https://json-schema.org), made from the models that read and write them; a test compares the two.

Angles are degrees, azimuths clockwise from true north, altitudes metres above the DEM's vertical datum, times UTC. A sigma
is one standard deviation. A *bias* sigma is of an error that all frames of a bundle share; a plain sigma is of an error
that no other frame shares. A field's name ends in its unit.
"""


def formats_page() -> str:
    """All documents; an object that several are made of is shown once."""
    shown: set[str] = set()
    parts = ["# Formats\n", GENERATED, INTRODUCTION]
    for document in DOCUMENTS:
        link = f"[{document.file}](../schemas/{document.file})"
        parts += [f"## {document.title}\n", f"{code(document.name)}. {document.where} Schema: {link}.\n"]
        for model, schema in objects_of(document):
            if model.__name__ not in shown:
                shown.add(model.__name__)
                parts.append(_object(model.__name__, schema, document))
    return "\n".join(parts)


def _object(name: str, schema: Schema, document: Document) -> str:
    rows = [
        [code(row.name), row.kind, row.unit, row.limits, row.default or "required", row.meaning]
        for row in field_rows(schema, {})
    ]
    header = ["field", "type", "unit", "range", "default", "meaning"]
    if document.written:  # all of it is there
        header.remove("default")
        rows = [[*row[:4], row[5]] for row in rows]
    text = from_docstring(schema.get("description", ""))
    return f"### {name}\n\n{text}\n\n{table(header, rows)}"
