"""A rig with a chip whose identity or readings are those of another: refused, in check, capture and watching."""

from pathlib import Path

import pytest
from fakes.simulated import quick_rig

from rig.attitude.altitude_plausibility import AltitudeBounds, altitude_bounds, require_plausible_altitude
from rig.attitude.kinematics import Attitude, JointAngles
from rig.attitude.tilt_agreement import require_agreement
from rig.check.devices import check_altimeter, check_devices
from rig.config.load import load_config
from rig.config.sections import I2cAltimeterSection
from rig.devices.sensors.iis2iclx import Iis2iclx
from rig.errors import DeviceError
from sim.commands.options import EMBEDDED_DEM
from sim.world.scenario import Altimeter, CameraOptics, Inclinometer, Scenario, Servo
from sim.world.truth import World


def section(kind: str, reference_altitude_m: float = 300.0) -> I2cAltimeterSection:
    return I2cAltimeterSection.model_validate(
        {
            "kind": kind,
            "bus": "/dev/i2c-1",
            "address": 0x77,
            "reference_pressure_hpa": 980.0,
            "reference_altitude_m": reference_altitude_m,
        }
    )


@pytest.mark.parametrize(
    ("altitude_m", "possible"), [(-100.0, False), (120.0, True), (2400.0, True), (2700.0, False)]
)
def test_an_altitude_is_compared_with_the_ground_there_is(altitude_m: float, possible: bool) -> None:
    bounds = [AltitudeBounds(100.0, 2500.0, "the ground of dem.tif lies at 400 to 2200 m")]
    if possible:
        require_plausible_altitude(altitude_m, 900.0, section("bmp390"), "BMP390", bounds)
        return
    with pytest.raises(DeviceError, match=rf"an altitude of {altitude_m:.0f} m, but the ground of dem\.tif"):
        require_plausible_altitude(altitude_m, 900.0, section("bmp390"), "BMP390", bounds)


@pytest.mark.parametrize(
    ("kind", "other", "part"), [("ms5611", "ms5607", "half"), ("ms5607", "ms5611", "twice")]
)
def test_the_refusal_names_the_barometer_that_answers_alike(kind: str, other: str, part: str) -> None:
    bounds = [AltitudeBounds(100.0, 2500.0, "[place] altitude_m says 300 m")]
    said = rf"an {other.upper()} read as an {kind.upper()} gives {part} the pressure: .*kind = \"{other}\""
    with pytest.raises(DeviceError, match=said):
        require_plausible_altitude(5950.0, 473.0, section(kind), kind.upper(), bounds)


def scenario(**parts: object) -> Scenario:
    return Scenario(
        servo=parts.pop("servo", Servo(swing_deg=0.0, max_velocity_deg_s=2000.0)),  # type: ignore[arg-type]
        camera=CameraOptics(
            width_px=160,
            height_px=120,
            fx_px=124.0,
            fy_px=124.0,
            cx_px=79.5,
            cy_px=59.5,
            distortion=(0.0,) * 5,
            frame_rate_hz=25.0,
        ),
        **parts,  # type: ignore[arg-type]
    )


def world(**parts: object) -> World:
    return World.create([EMBEDDED_DEM], scenario(**parts), 5)


def test_check_and_capture_refuse_an_ms5607_that_is_configured_as_an_ms5611(tmp_path: Path) -> None:
    with quick_rig(
        world(altimeter=Altimeter(kind="ms5611", soldered="ms5607")), tmp_path, in_this_process=True
    ) as quick:
        rows = {row.device: row for row in check_devices(load_config(quick.rig.config_path))}
        assert 'kind = "ms5607"' in str(rows["altimeter"].problem)
        assert "[place] altitude_m says" in str(rows["altimeter"].problem)
        with pytest.raises(DeviceError, match=r"MS5611 .* would be an altitude of \d{4} m, but \[place\]"):
            quick.capture()
        assert quick.left_over() == []


def test_an_ms5607_that_is_configured_as_one_is_taken(tmp_path: Path) -> None:
    with quick_rig(world(altimeter=Altimeter(kind="ms5607")), tmp_path, in_this_process=True) as quick:
        config = load_config(quick.rig.config_path)
        assert config.altimeter is not None
        row = check_altimeter(config.altimeter, altitude_bounds(config))
        assert row.problem is None
        altitude_m = float(row.reading.split(", ")[1].removesuffix(" m"))
        assert altitude_m == pytest.approx(quick.world.truth_json()["altitude_m"], abs=60.0)


@pytest.mark.parametrize(
    ("soldered", "named"),
    [("ism330dhcx", "iis2iclx"), pytest.param("adxl357", "adxl355", marks=pytest.mark.long)],
)
def test_check_refuses_an_inclinometer_of_another_scale(soldered: str, named: str, tmp_path: Path) -> None:
    fitted = Inclinometer.model_validate({"chip": named, "soldered": soldered})
    with quick_rig(world(inclinometer=fitted), tmp_path, in_this_process=True) as quick:
        rows = {row.device: row for row in check_devices(load_config(quick.rig.config_path))}
        assert "identity" in str(rows["inclinometer"].problem)


@pytest.mark.long
def test_a_scale_that_only_the_servo_can_show_refuses_the_capture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Iis2iclx, "_require_two_axes", lambda self, data: None)
    fitted = Inclinometer(chip="iis2iclx", soldered="ism330dhcx")
    with quick_rig(world(inclinometer=fitted), tmp_path, in_this_process=True) as quick:
        with pytest.raises(
            DeviceError, match=r"IIS2ICLX .* turned it by 10\.0 deg, a factor of 0\.2\d; look at"
        ):
            quick.capture()
        assert quick.torques == [0, 0]


LEVEL = Attitude(30.0, 2.0, -1.0)


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 4.0, -1.0, 0.0])
def test_a_tilt_that_disagrees_with_the_servo_by_a_factor_is_no_play(factor: float) -> None:
    from rig.attitude.kinematics import body_attitude, head_rotation

    joints = JointAngles(40.0, 10.0)
    level_deg = body_attitude(head_rotation(LEVEL, JointAngles(40.0, 0.0))).tilt_deg
    tilted_deg = body_attitude(head_rotation(LEVEL, joints)).tilt_deg
    require_agreement(LEVEL, joints, tilted_deg + 1.5, "chip")
    with pytest.raises(DeviceError, match=rf"a factor of {factor:.2f}"):
        require_agreement(LEVEL, joints, level_deg + factor * (tilted_deg - level_deg), "chip")


def test_at_a_small_tilt_nothing_is_said() -> None:
    require_agreement(LEVEL, JointAngles(0.0, 3.0), 2.75, "chip")


def test_the_bounds_are_those_of_place_dem_and_reference() -> None:
    class Place:
        altitude_m = 300.0
        model_fields_set = frozenset({"altitude_m"})

    class Config:
        place: object | None = Place()
        altimeter = section("ms5611", 500.0)

    bounds = altitude_bounds(Config())  # type: ignore[arg-type]
    assert [(bound.low_m, bound.high_m) for bound in bounds] == [(-3200.0, 3800.0)]
    Config.place = None
    assert [(b.low_m, b.high_m) for b in altitude_bounds(Config())] == [(-3000.0, 4000.0)]  # type: ignore[arg-type]
    Config.altimeter = section("bmp390", 500.0)
    assert altitude_bounds(Config()) == ()  # type: ignore[arg-type]


def test_watching_warns_of_an_altitude_that_cannot_be(tmp_path: Path) -> None:
    from rig.watch.sources import sources_of

    fitted = Altimeter(kind="ms5611", soldered="ms5607")
    with (
        quick_rig(world(altimeter=fitted), tmp_path, in_this_process=True) as quick,
        sources_of(load_config(quick.rig.config_path))["altimeter"]() as source,
    ):
        assert 'kind = "ms5607"' in source.read().warnings[0]
