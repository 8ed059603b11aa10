"""A scenario file holds only what differs from the defaults; errors in it are reported with the key."""

from pathlib import Path

import pytest

from sim.errors import SimulationError
from sim.shipped_files import scenario_file
from sim.world.scenario import Scenario, load_scenario

SCENARIOS = Path(__file__).parents[3] / "configs" / "scenarios"


def test_the_documented_file_holds_every_default() -> None:
    text = (SCENARIOS / "default.toml").read_text(encoding="utf-8")
    assert load_scenario(SCENARIOS / "default.toml") == Scenario() == load_scenario(None)
    for name, section in Scenario().model_dump().items():
        assert f"[{name}]" in text
        for key in section:
            assert f"{key} = " in text, f"{name}.{key} is not documented"


def test_a_scenario_that_comes_with_skyfix_is_had_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("default", "ideal", "uncalibrated"):
        assert load_scenario(Path(name)) == load_scenario(SCENARIOS / f"{name}.toml")
    assert scenario_file(Path("evaluate/cloud")).samefile(SCENARIOS / "evaluate" / "cloud.toml")
    for other in ("absent", "", "..", "../configs", str(SCENARIOS / "ideal"), "ideal.toml"):
        assert scenario_file(Path(other)) == Path(other)


def test_a_file_goes_before_a_scenario_of_that_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ideal").write_text("[vehicle]\nmast_height_m = 3.0\n")
    assert load_scenario("ideal").vehicle.mast_height_m == 3.0


def test_in_the_ideal_scenario_nothing_is_wrong() -> None:
    ideal = load_scenario(SCENARIOS / "ideal.toml").model_dump()
    errors = [
        (section, key, value)
        for section, keys in ideal.items()
        for key, value in keys.items()
        if "sigma" in key
        or "noise" in key
        or key in {"backlash_deg", "motor_current_field_ut", "max_tilt_deg"}
    ]
    assert len(errors) > 15
    assert all(value == 0.0 for _, _, value in errors), errors


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("[servo]\nbacklash = 1", r"servo\.backlash: unknown key"),
        ("[servos]\nbacklash_deg = 1", "servos: unknown key"),
        ("[servo]\nbacklash_deg = -1", r"servo\.backlash_deg: .*greater than or equal to 0"),
        ("[compass]\nkind = 'gps'", r"compass\.kind: .*mmc5983ma"),
        ("[place]\nlat_deg = 37.2", "place: .*both lat_deg and lon_deg"),
        ("[camera]\nfx_px = nan", r"camera\.fx_px"),
        ("[camera\n", "not valid TOML"),
    ],
)
def test_a_slip_is_named_with_its_place(tmp_path: Path, content: str, named: str) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(SimulationError, match=named) as failure:
        load_scenario(path)
    assert str(path) in str(failure.value)
    assert "\n" not in str(failure.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match=r"nowhere\.toml: No such file"):
        load_scenario(tmp_path / "nowhere.toml")
