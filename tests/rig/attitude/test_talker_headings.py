"""What talkers claim of north, variation and deviation, against what the rig knows better."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from rig.attitude.declination import declination
from rig.attitude.talker_headings import TrueHeadings, heading_notes, true_headings
from rig.clock import Instant
from rig.config.sections import NmeaCompassSection, Place
from rig.devices.readings import HeadingReading
from rig.devices.sensors.nmea import checksum, parse_heading, parse_sentence
from rig.errors import ConfigError, DeviceError
from rig.fault_notes import collecting

NOON = datetime(2026, 11, 26, 12, tzinfo=UTC)
SANTA_CRUZ = Place(lat_deg=37.2, lon_deg=-122.1)
NORTH_DEG = 12.7
"""The declination there, east."""
PANS_DEG = (-135.0, -45.0, 45.0, 135.0)
HEADING_DEG = 30.4
"""Of the vehicle, from magnetic north."""
SECTION = NmeaCompassSection(kind="nmea", port="/dev/ttyUSB0")
REPORTS = Path(__file__).parents[2] / "logs" / "nmea"


@dataclass(frozen=True)
class Joints:
    pan_deg: float


@dataclass(frozen=True)
class Stop:
    joints: Joints
    headings: tuple[HeadingReading, ...]
    utc: datetime = NOON


def reading(body: str, utc: datetime = NOON) -> HeadingReading:
    line = f"${body}*{checksum(body.encode()):02X}".encode()
    found = parse_heading(parse_sentence(line), Instant(0.0, utc))
    assert found is not None
    return found


def stops(*forms: str, utc: datetime = NOON) -> list[Stop]:
    """A turn of the head; ``{m}`` in a sentence is the magnetic heading, ``{t}`` the true one, ``{off}`` one 20 deg aside."""
    found = []
    for pan_deg in PANS_DEG:
        magnetic_deg = (HEADING_DEG + pan_deg) % 360.0
        values = {
            "m": f"{magnetic_deg:.1f}",
            "t": f"{(magnetic_deg + NORTH_DEG) % 360.0:.1f}",
            "off": f"{(magnetic_deg + 20.0) % 360.0:.1f}",
            "whole": f"{round(magnetic_deg)}",
        }
        headings = tuple(reading(form.format(**values), utc) for form in forms)
        found.append(Stop(Joints(pan_deg), headings, utc))
    return found


def ahead_deg(found: TrueHeadings) -> list[float]:
    """Of the vehicle, by each reading."""
    return [
        round((heading_deg - at.pan_deg) % 360.0, 1)
        for at in found.at_pans
        for heading_deg in at.headings_deg
    ]


def judged(
    given: Sequence[Stop], place: Place | None = SANTA_CRUZ, section: NmeaCompassSection = SECTION
) -> tuple[TrueHeadings, list[str]]:
    with collecting() as faults:
        found = true_headings(given, section, place)
    return found, [note.problem for note in faults.all()]


def require_true(found: TrueHeadings, within_deg: float = 0.2) -> None:
    assert ahead_deg(found)
    assert all(abs(each - HEADING_DEG - NORTH_DEG) <= within_deg for each in ahead_deg(found))


class TestVariation:
    @pytest.mark.parametrize(
        "form", ["HCHDG,{m},,,12.7,E", "HCHDM,{m},M", "HCHDT,{t},T", "C{m}P0.2R-0.1T19.0"]
    )
    def test_a_correct_variation_is_used_without_a_note(self, form: str) -> None:
        found, problems = judged(stops(form))
        require_true(found)
        assert not problems

    @pytest.mark.parametrize(
        ("form", "said"),
        [
            ("HCHDG,{m},0.0,E,0.0,E", "sends the variation 0.0 deg, and the World Magnetic Model has 12.7"),
            ("HCHDG,{m},0.0,E,0.0,W", "sends the variation 0.0 deg"),
            ("HCHDG,{m},,,12.7,W", "sends the variation -12.7 deg"),  # the wrong letter
            ("HCHDG,{m},,,17.5,E", "sends the variation 17.5 deg"),  # of decades ago
        ],
    )
    def test_a_claim_that_the_model_contradicts_is_noted_and_not_used(self, form: str, said: str) -> None:
        found, problems = judged(stops(form))
        require_true(found)
        assert found.declination is not None
        assert found.declination.source == "World Magnetic Model"
        assert [problem for problem in problems if said in problem]

    @pytest.mark.parametrize("filler", ["999.9,E", "180.0,E"])
    def test_a_filler_that_is_no_angle_is_none(self, filler: str) -> None:
        require_true(judged(stops(f"HCHDG,{{m}},,,{filler}"))[0])

    def test_the_reported_lines(self) -> None:
        lines = (REPORTS / "n04-hdg-variation-zero.nmea").read_bytes().splitlines()
        headings = tuple(
            found for line in lines if (found := parse_heading(parse_sentence(line), Instant(0.0, NOON)))
        )
        (doubt,) = heading_notes(headings[:1], SECTION, SANTA_CRUZ)
        assert doubt == (
            "sends the variation 0.0 deg, and the World Magnetic Model has 12.7 deg at [place]: the model's is used"
        )
        assert heading_notes(headings[:1], SECTION, Place(lat_deg=27.7, lon_deg=85.3)) == [], "nearly 0 there"

    def test_a_zero_that_nothing_confirms_is_no_variation(self) -> None:
        with pytest.raises(
            ConfigError, match=r"the variation 0\.0 that it sends may be a filler; give it, or"
        ):
            judged(stops("HCHDG,{m},,,0.0,E"), place=None)
        found, _ = judged(stops("HCHDG,{m},,,12.7,E"), place=None)
        require_true(found)

    def test_the_configured_declination_is_above_all(self) -> None:
        section = SECTION.model_copy(update={"declination_deg": NORTH_DEG})
        found, problems = judged(stops("HCHDG,{m},,,0.0,E"), section=section)
        require_true(found)
        assert not problems

    def test_hdm_with_hdg_uses_its_variation(self) -> None:
        found, problems = judged(stops("HCHDG,{m},,,12.7,E", "HCHDM,{m},M"), place=None)
        require_true(found)
        assert not problems

    def test_a_variation_of_another_year_widens_the_sigma(self) -> None:
        near, off = (judged(stops(f"HCHDG,{{m}},,,{sent},E"))[0].sigma_deg for sent in (12.7, 14.3))
        assert near < 0.1
        assert off == pytest.approx(0.8, abs=0.1)


class TestDeviation:
    @pytest.mark.parametrize(
        "form", ["HCHDG,{m},12.7,E,12.7,E", "HCHDG,{m},12.7,E,,", "HCHDG,{m},12.7,E,0.0,E"]
    )
    def test_a_variation_in_the_deviation_s_field_is_added_once(self, form: str) -> None:
        found, problems = judged(stops(form))
        require_true(found)
        assert "sends the variation 12.7 deg as its deviation" in problems

    def test_twice_the_same_is_seen_without_a_place(self) -> None:
        found, problems = judged(stops("HCHDG,{m},12.7,E,12.7,E"), place=None)
        require_true(found)
        assert problems

    def test_a_deviation_that_changes_with_the_heading_is_one(self) -> None:
        given = []
        for stop, deviation in zip(
            stops("HCHDG,{m},,,12.7,E"), ("12.7,E", "11.0,E", "13.1,E", "12.0,E"), strict=True
        ):
            degrees = float(deviation.split(",")[0])
            sensor_deg = (HEADING_DEG + stop.joints.pan_deg - degrees) % 360.0
            given.append(replace(stop, headings=(reading(f"HCHDG,{sensor_deg:.1f},{deviation},12.7,E"),)))
        found, problems = judged(given)
        require_true(found)
        assert not problems

    def test_a_small_constant_one_is_a_deviation_too(self) -> None:
        found, problems = judged(stops("HCHDG,{m},2.0,W,12.7,E"))
        assert set(ahead_deg(found)) == {round(HEADING_DEG + NORTH_DEG - 2.0, 1)}
        assert not problems


class TestNorths:
    def test_a_magnetic_heading_sold_as_a_true_one_is_left_out(self) -> None:
        found, problems = judged(stops("HCHDM,{m},M", "HCHDT,{m},T"))
        require_true(found)
        assert problems == ["sends its magnetic heading as a true one, in HCHDT"]

    def test_a_true_heading_by_another_variation_is_left_out(self) -> None:
        found, problems = judged(stops("HCHDM,{m},M", "HCHDT,{off},T"))
        require_true(found)
        assert problems == ["is 20.0 deg from magnetic to true in HCHDT, 12.7 are right"]

    def test_both_that_agree_are_taken(self) -> None:
        found, problems = judged(stops("HCHDM,{m},M", "HCHDT,{t},T"))
        require_true(found)
        assert len(ahead_deg(found)) == 8
        assert not problems

    def test_the_same_value_is_right_where_there_is_no_declination(self) -> None:
        _, problems = judged(stops("HCHDM,{m},M", "HCHDT,{m},T"), place=Place(lat_deg=27.7, lon_deg=85.3))
        assert not problems

    @pytest.mark.parametrize("other", ["TIHDM,{off},M", "GPHDT,{m},T"])
    def test_two_instruments_that_disagree_are_an_error_and_no_mean(self, other: str) -> None:
        with pytest.raises(
            DeviceError, match=r"its sources do not agree: .*; choose one with .compass. sentence"
        ):
            judged(stops("HCHDM,{m},M", other))

    @pytest.mark.parametrize(
        ("other", "said"), [("HCHDT,{m},T", "sends its magnetic"), ("TIHDM,{off},M", None)]
    )
    def test_talkers_that_take_turns_are_compared_too(self, other: str, said: str | None) -> None:
        """One sentence at each stop, as of talkers that are slower than the head."""
        given = [
            replace(stop, headings=stop.headings[number % 2 : number % 2 + 1])
            for number, stop in enumerate(stops("HCHDM,{m},M", other))
        ]
        if said is None:
            with pytest.raises(DeviceError, match="its sources do not agree"):
                judged(given)
            return
        found, problems = judged(given)
        require_true(found)
        assert said in problems[0]

    def test_a_coarse_source_does_not_spoil_a_fine_one(self) -> None:
        found, _ = judged(stops("HCHDM,{m},M", "TIHDM,{whole},M"))
        assert len(ahead_deg(found)) == 4

    def test_an_estimated_heading_is_noted_and_has_a_wide_sigma(self) -> None:
        found, problems = judged(stops("GPTHS,{t},E"))
        assert problems == ["its heading is estimated (dead reckoning)"]
        assert found.sigma_deg >= 5.0


class TestResolution:
    @pytest.mark.parametrize(
        ("form", "sigma_deg"),
        [("HCHDM,{whole},M", 0.289), ("HCHDM,{whole}.0,M", 0.289), ("HCHDM,{m}5,M", 0.003)],
    )
    def test_the_step_is_in_the_sigma(self, form: str, sigma_deg: float) -> None:
        assert judged(stops(form))[0].sigma_deg == pytest.approx(sigma_deg, abs=0.001)

    def test_one_reading_with_a_decimal_is_enough(self) -> None:
        given = stops("HCHDM,{whole}.0,M")
        given[2] = replace(given[2], headings=(*given[2].headings, reading("HCHDM,75.3,M")))
        assert judged(given)[0].sigma_deg == pytest.approx(0.1 / 12**0.5, abs=0.001)


@pytest.mark.parametrize(
    ("year", "side"), [(1970, "before"), (2024, "before"), (2031, "after"), (2106, "after")]
)
def test_a_wrong_clock_takes_the_nearest_date(year: int, side: str) -> None:
    when = datetime(year, 3, 1, tzinfo=UTC)
    found = declination(None, None, SANTA_CRUZ, when)
    nearest = declination(
        None, None, SANTA_CRUZ, datetime(2025 if side == "before" else 2029, 12, 31, tzinfo=UTC)
    )
    assert found.declination_deg == pytest.approx(nearest.declination_deg, abs=0.2)
    assert found.doubt == (
        f"the computer's clock says {year}-03-01, {side} the World Magnetic Model's years 2025 to 2030"
    )
    assert 0.1 < found.sigma_deg < 1.0, "what the declination changes in these years"
    require_true(judged(stops("HCHDM,{m},M", utc=when))[0], within_deg=0.5)
