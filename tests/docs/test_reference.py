"""The reference and the JSON Schema files are those of the code, and hold for real documents."""

import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any

import jsonschema_rs
import pytest
from click.testing import CliRunner
from generate.commands import PROGRAMS, commands_of, commands_page, help_text
from generate.configuration import key_rows, sections_of
from generate.fields import description, docstrings, kind_of, limits_of, unit_of
from generate.reference import DOCS, generated_files
from generate.schemas import DOCUMENTS, Document, objects_of
from pydantic import BaseModel

from localizer.bundle import BundleError, parse_bundle
from localizer.fix import Candidate, Fix, Position, Reason, Stage1Counts
from localizer.track.document import TrackLine
from rig.config.sections import AllSections

FILES = generated_files()
BY_NAME = {document.name: document for document in DOCUMENTS}
RENDERED = Path(os.environ.get("SKYFIX_DATA", "/nonexistent")) / "rendered"


def validator(name: str) -> jsonschema_rs.Validator:
    schema = json.loads((DOCS / "schemas" / BY_NAME[name].file).read_text())
    return jsonschema_rs.validator_for(schema, validate_formats=True)


@pytest.mark.parametrize("file", sorted(FILES), ids=lambda file: file.name)
def test_what_is_committed_is_what_the_code_says(file: Path) -> None:
    assert file.read_text() == FILES[file], f"{file} is stale: run make reference"


@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_a_schema_is_valid_and_explains_every_field(name: str) -> None:
    document = BY_NAME[name]
    assert jsonschema_rs.meta.is_valid(document.schema())
    for model, schema in objects_of(document):
        for field, described in schema["properties"].items():
            assert described.get("description"), f"{model.__name__}.{field} has no docstring"


@pytest.mark.parametrize(("name", "model"), list(sections_of(AllSections)))
def test_every_key_of_the_configuration_is_explained(name: str, model: type[BaseModel]) -> None:
    for key, *_, meaning in key_rows(model):
        assert meaning, f"{name} {key} has no docstring"


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_every_option_of_every_command_is_on_the_page(program: str) -> None:
    page = commands_page()
    for name, command in commands_of(PROGRAMS[program], program):
        section = page.split(f"# {name}\n", 1)[1].split("\n##")[0]
        for parameter in command.params:
            for option in parameter.opts if parameter.param_type_name == "option" else ():
                row = re.search(rf"^\| `[^`]*{option}\b[^`]*` \| (\S[^|]*)\|", section, re.MULTILINE)
                assert row, f"{name} {option} is not explained"


def test_the_help_of_a_command_is_the_page_in_other_words() -> None:
    shown = CliRunner().invoke(PROGRAMS["rig"], ["capture", "--help"], prog_name="rig").output
    words = re.sub(r"\W", "", shown)
    section = commands_page().split("### rig capture\n")[1].split("\n###")[0]
    for paragraph in re.findall(r"^[A-Z][^|`\n]{40,}$", section, re.MULTILINE):
        assert re.sub(r"\W", "", paragraph.replace("\\", "")) in words


def test_what_help_prints_verbatim_stays_so() -> None:
    text = help_text('Do it.\n\n\b\n  {"a": 1}\n  {"b": 2}\n\nMore.\n\nExample: rig capture\n  --out bundles')
    assert '```\n{"a": 1}\n{"b": 2}\n```' in text
    assert "```\nrig capture --out bundles\n```" in text


def fix(**changes: Any) -> Fix:
    position = Position(
        easting_m=1.0,
        northing_m=2.0,
        crs="EPSG:26910",
        lat_deg=46.2,
        lon_deg=-122.2,
        ground_m=3.0,
        row=4.0,
        col=5.0,
    )
    fields: dict[str, Any] = {
        "bundle": "20261123T043151Z-3f9a",
        "status": "fix",
        "position": position,
        "covariance_m2": ((9.0, 0.4), (0.4, 7.0)),
        "probability": 0.999,
        "candidates": (Candidate(easting_m=1.0, northing_m=2.0, probability=0.999, rms_px=0.8),),
        "stage1": Stage1Counts(cells=9, after_altitude=5, after={"N": 2}, points_explored=40),
        "residual": {"N": 0.7},
        "nuisance": None,
        "timing_s": {"stage1": 0.1},
    }
    return Fix(**fields | changes)


def test_fixes_as_they_are_written_are_valid() -> None:
    none = fix(
        status="none",
        position=None,
        covariance_m2=None,
        probability=0.0,
        candidates=(),
        reason=Reason(code="outside", text="The skyline fits no place."),
    )
    for each in (fix(), none):
        validator("skyfix.fix/1").validate(json.loads(each.to_json()))


@pytest.mark.parametrize(
    "wrong",
    [
        {"status": "certain"},
        {"probability": 1.5},
        {"schema": "skyfix.fix/2"},
        {"covariance_m2": [[1.0, 0.0]]},
        {"unknown": 1},
    ],
)
def test_what_is_no_fix_is_refused(wrong: dict[str, Any]) -> None:
    assert not validator("skyfix.fix/1").is_valid(json.loads(fix().to_json()) | wrong)


@pytest.mark.parametrize("missing", ["schema", "elsewhere", "reason", "position"])
def test_a_fix_has_all_of_its_fields(missing: str) -> None:
    document = json.loads(fix().to_json())
    del document[missing]
    assert not validator("skyfix.fix/1").is_valid(document)


def test_a_line_of_a_track_is_valid() -> None:
    line = TrackLine(bundle="b", mode="whole DEM", fix=fix(), hypotheses=(), elsewhere=0.2)
    validator("skyfix.track/1").validate(json.loads(line.to_json()))


BUNDLE = {
    "schema": "skyfix.bundle/1",
    "id": "20261123T043151Z-3f9a",
    "created": "2026-11-23T04:31:51Z",
    "camera": {
        "width_px": 640,
        "height_px": 480,
        "fx_px": 492.8,
        "fy_px": 492.8,
        "cx_px": 319.5,
        "cy_px": 239.5,
    },
    "mast_height_m": 2.0,
    "altitude": {"value_m": 1432.6, "sigma_m": 5.0},
    "azimuth_bias_sigma_deg": 0.5,
    "tilt_bias_sigma_deg": 0.02,
    "frames": [
        {
            "label": "N",
            "file": "frames/N.png",
            "sha256": "0" * 64,
            "time": "2026-11-23T04:31:40Z",
            "azimuth_deg": 0.12,
            "azimuth_sigma_deg": 0.1,
            "tilt_deg": 4.98,
            "tilt_sigma_deg": 0.01,
            "roll_deg": -0.31,
            "roll_sigma_deg": 0.02,
        }
    ],
}


def test_the_contract_s_bundle_is_valid_with_fields_that_nobody_knows() -> None:
    assert parse_bundle(json.dumps(BUNDLE).encode(), "bundle.json").id == BUNDLE["id"]
    validator("skyfix.bundle/1").validate(BUNDLE | {"raw": {"pressure_hpa": 850.1}})


@pytest.mark.parametrize(
    "wrong",
    [
        {"id": ".hidden"},
        {"created": "2026-11-23T04:31:51+02:00"},
        {"frames": []},
        {"altitude": {"value_m": 1432.6}},
        {"mast_height_m": -1.0},
        {"camera": BUNDLE["camera"] | {"model": "fisheye"}},  # type: ignore[operator]
        {"camera": BUNDLE["camera"] | {"focal_sigma_fraction": 0.1}},  # type: ignore[operator]
        {"schema": "skyfix.bundle/2"},
    ],
)
def test_schema_and_reader_refuse_the_same_bundles(wrong: dict[str, Any]) -> None:
    document = BUNDLE | wrong
    with pytest.raises(BundleError):
        parse_bundle(json.dumps(document).encode(), "bundle.json")
    assert not validator("skyfix.bundle/1").is_valid(document)


@pytest.mark.skipif(not RENDERED.is_dir(), reason="SKYFIX_DATA names no folder with rendered bundles")
def test_bundles_of_others_are_valid() -> None:
    files = sorted(RENDERED.glob("*/bundle/bundle.json"))
    assert files
    for file in files:
        validator("skyfix.bundle/1").validate(json.loads(file.read_text()))


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_demo_s_bundle_and_fix_are_valid(tmp_path: Path) -> None:
    subprocess.run(["sim", "demo", "--seed", "1", "--out", str(tmp_path)], check=True, capture_output=True)
    (bundle,) = tmp_path.rglob("bundle.json")
    validator("skyfix.bundle/1").validate(json.loads(bundle.read_text()))
    (answer,) = tmp_path.rglob("fix.json")
    validator("skyfix.fix/1").validate(json.loads(answer.read_text()))


@pytest.mark.parametrize("kind", ["camera", "inclinometer", "compass", "altimeter", "boresight"])
def test_a_calibration_says_its_kind(kind: str) -> None:
    schema = BY_NAME["skyfix.calibration/1"].schema()
    assert schema["discriminator"]["mapping"][kind]
    part = schema["$defs"][schema["discriminator"]["mapping"][kind].rpartition("/")[2]]
    assert {"schema", "kind", "id"} <= set(part["required"])


def test_types_units_and_limits_in_words() -> None:
    assert kind_of({"enum": ["a", "b", "c"]}) == '`"a"`, `"b"` or `"c"`'
    assert kind_of({"anyOf": [{"$ref": "#/$defs/Place"}, {"type": "null"}]}) == "[Place](#place) or null"
    pair = {"type": "array", "prefixItems": [{"type": "number"}] * 2, "minItems": 2, "maxItems": 2}
    assert kind_of({**pair, "prefixItems": [pair] * 2}) == "array of 2 arrays of 2 numbers"
    assert limits_of({"type": "number", "exclusiveMinimum": 0, "maximum": 1e6}) == "> 0, ≤ 1000000"
    assert limits_of({"type": "array", "items": {"type": "string"}, "minItems": 1}) == "at least 1 item"
    assert [unit_of(name) for name in ("tilt_deg", "velocity_deg_s", "row", "covariance_m2")] == [
        "°",
        "°/s",
        "",
        "m²",
    ]


def test_docstrings_of_a_base_are_its_heirs() -> None:
    class Base(BaseModel):
        size_m: float
        """How large."""

    class Heir(Base):
        mass_kg: float
        """How heavy."""
        name: str

    assert docstrings(Heir) == {"size_m": "How large.", "mass_kg": "How heavy."}


def test_what_is_said_in_a_section_counts_where_nothing_is_said_below_the_field() -> None:
    class Place(BaseModel):
        """A place,
        somewhere.

        Attributes
        ----------
        row, col : float
            In the DEM's cells,
            centres at whole numbers.
        crs : str
            Of the place.

        Examples
        --------
        >>> Place
        """

        row: float
        col: float
        crs: str
        """Of the grid."""

    cells = "In the DEM's cells, centres at whole numbers."
    assert docstrings(Place) == {"row": cells, "col": cells, "crs": "Of the grid."}
    assert description(Place) == "A place, somewhere."


def test_a_document_s_file_bears_its_name_and_version() -> None:
    assert Document("skyfix.any/3", "", (Fix,), Fix, True, "").file == "skyfix.any-3.schema.json"
