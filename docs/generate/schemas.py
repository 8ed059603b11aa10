"""JSON Schema files of the documents that programs exchange, from the pydantic models that read and write them."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, TypeAdapter

from generate.fields import description, docstrings, models_in
from localizer.bundle import Bundle
from localizer.fix import Fix
from localizer.track.document import TrackLine
from rig.config.calibration_files import (
    AltimeterCalibration,
    BoresightCalibration,
    Calibration,
    CameraCalibration,
    CompassCalibration,
    InclinometerCalibration,
)

DIALECT = "https://json-schema.org/draft/2020-12/schema"


@dataclass(frozen=True)
class Document:
    """A document: its name with the version, the models that it is one of, and where it is found.

    ``written``: the schema is of what skyfix writes, all fields of which are there; else of what it reads.
    """

    name: str
    title: str
    models: tuple[type[BaseModel], ...]
    whole: Any
    written: bool
    where: str

    @property
    def file(self) -> str:
        """Name of the schema's file."""
        return f"{self.name.replace('/', '-')}.schema.json"

    def schema(self) -> dict[str, Any]:
        """The JSON Schema, with the docstrings of all fields."""
        mode: Literal["serialization", "validation"] = "serialization" if self.written else "validation"
        schema = TypeAdapter(self.whole).json_schema(by_alias=True, mode=mode)
        _describe(schema, self.models, self.written)
        return {"$schema": DIALECT, **{key: value for key, value in schema.items() if key != "title"}}

    def schema_text(self) -> str:
        """The content of the schema's file."""
        return json.dumps(self.schema(), indent=2, ensure_ascii=False) + "\n"


DOCUMENTS = (
    Document(
        "skyfix.bundle/1",
        "The measurement bundle",
        (Bundle,),
        Bundle,
        False,
        "`bundle.json` in a bundle's folder. `rig capture` writes it, `localizer locate` reads it. A field that is not listed"
        " is kept and not read: `raw` and `calibration` hold the readings that the frames were derived from.",
    ),
    Document(
        "skyfix.fix/1",
        "The fix",
        (Fix,),
        Fix,
        True,
        "What `localizer locate --json` prints, and what `rig run` keeps and publishes.",
    ),
    Document(
        "skyfix.track/1",
        "A line of a track",
        (TrackLine,),
        TrackLine,
        True,
        "What `localizer track --json` prints for each bundle.",
    ),
    Document(
        "skyfix.calibration/1",
        "The calibration",
        (
            CameraCalibration,
            InclinometerCalibration,
            CompassCalibration,
            AltimeterCalibration,
            BoresightCalibration,
        ),
        Calibration,
        False,
        "What `rig calibrate` writes and `[calibration]` of the configuration names. `kind` says which of five it is.",
    ),
)


def objects_of(document: Document) -> Iterator[tuple[type[BaseModel], dict[str, Any]]]:
    """The objects that a document is made of, each with its part of the schema, the outermost first."""
    schema = document.schema()
    parts = schema.get("$defs", {})
    for outermost in document.models:
        for model in models_in(outermost):
            yield model, parts.get(model.__name__, schema)


def _describe(schema: dict[str, Any], outermost: tuple[type[BaseModel], ...], written: bool) -> None:
    """Give each property its field's docstring, and require what has to be there.

    That is all of what skyfix writes. Of what it reads it is what a model has no default for, and what says which document
    it is.
    """
    parts = schema.get("$defs", {})
    for model in dict.fromkeys(each for top in outermost for each in models_in(top)):
        part = parts.get(model.__name__, schema)
        part.pop("title", None)
        part["description"] = description(model).replace("``", "`")
        texts = docstrings(model)
        for name, field in model.model_fields.items():
            described = part["properties"][field.alias or name]
            described.pop("title", None)
            if name in texts:
                described["description"] = texts[name].replace("``", "`")
        names_itself = {"schema", "kind"} if model in outermost else set()
        needed = {*part["properties"]} if written else {*part.get("required", ()), *names_itself}
        part["required"] = [name for name in part["properties"] if name in needed]
