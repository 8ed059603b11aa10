"""``localizer track``: bundles with pictures, and a file of odometry."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from craters import EAST_SPOT, OPTICS, WEST_SPOT

from localizer.bundle import Bundle, Camera, Frame, sha256_of
from localizer.commands import cli
from localizer.observation import Observation
from localizer.track.document import TrackLine


@pytest.fixture(scope="module")
def drive(scene, tmp_path_factory) -> list[Path]:
    """Bundles from the western and the eastern spot of crater 0, with pictures of plain sky over plain ground."""
    folder = tmp_path_factory.mktemp("drive")
    return [
        picture_bundle(folder, scene.look(0, spot), number)
        for number, spot in enumerate((WEST_SPOT, EAST_SPOT))
    ]


def picture_bundle(folder: Path, observation: Observation, number: int) -> Path:
    directory = folder / f"stop-{number}"
    (directory / "frames").mkdir(parents=True)
    rng = np.random.default_rng(number)
    rows_px = np.arange(float(OPTICS.height_px))[:, None]
    frames = []
    for frame in observation.frames:
        skyline_px = np.interp(np.arange(OPTICS.width_px), frame.u_px, frame.v_px)
        ground = np.clip(rows_px - skyline_px + 0.5, 0.0, 1.0)[..., None]
        picture = (1.0 - ground) * (235.0, 200.0, 160.0) + ground * (50.0, 80.0, 60.0)
        file = directory / "frames" / f"{frame.label}.png"
        cv2.imwrite(
            str(file), np.clip(picture + rng.normal(0.0, 2.0, picture.shape), 0, 255).astype(np.uint8)
        )
        frames.append(
            Frame(
                label=frame.label,
                file=f"frames/{frame.label}.png",
                sha256=sha256_of(file),
                time=f"2026-11-23T04:3{number}:40Z",
                azimuth_deg=frame.azimuth_deg,
                azimuth_sigma_deg=frame.azimuth_sigma_deg,
                tilt_deg=frame.tilt_deg,
                tilt_sigma_deg=frame.tilt_sigma_deg,
                roll_deg=frame.roll_deg,
                roll_sigma_deg=frame.roll_sigma_deg,
            )
        )
    bundle = Bundle(
        id=directory.name,
        created=f"2026-11-23T04:3{number}:51Z",
        camera=Camera(**OPTICS.model_dump(include=set(Camera.model_fields))),
        mast_height_m=observation.mast_height_m,
        altitude={"value_m": observation.altitude_m, "sigma_m": 5.0},
        azimuth_bias_sigma_deg=observation.azimuth_bias_sigma_deg,
        tilt_bias_sigma_deg=observation.tilt_bias_sigma_deg,
        frames=frames,
    )
    (directory / "bundle.json").write_text(bundle.to_json())
    return directory


@pytest.fixture
def run(monkeypatch, capfd):
    """Runs ``localizer track`` with arguments: exit status, standard output, standard error."""

    def run(*arguments):
        monkeypatch.setattr("sys.argv", ["localizer", "track", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, *capfd.readouterr()

    return run


def legs_file(tmp_path: Path, *lines: str) -> Path:
    file = tmp_path / "legs.jsonl"
    file.write_text("\n".join(lines))
    return file


EAST_200_M = '{"distance_m": 200, "distance_sigma_m": 4, "heading_deg": 90, "heading_sigma_deg": 2}'


@pytest.mark.long
def test_the_command_prints_an_object_for_each_bundle_and_ends_as_the_last(scene, drive, run, tmp_path):
    legs = legs_file(tmp_path, EAST_200_M)
    status, out, err = run(*drive, "--dem", scene.dem_path, "--odometry", legs, "--json")
    assert (status, err) == (0, "")
    first, second = (TrackLine.model_validate_json(line) for line in out.splitlines())
    assert (first.schema_name, first.bundle, first.mode) == ("skyfix.track/1", "stop-0", "whole DEM")
    assert (first.fix.status, second.fix.status) == ("ambiguous", "fix")
    assert len(first.hypotheses) == 2
    for line in (first, second):
        assert sum(h.probability for h in line.hypotheses) + line.elsewhere == pytest.approx(1.0, abs=1e-6)
    assert scene.error_cells(second.fix, 0, EAST_SPOT) < 0.5
    assert second.hypotheses[0].easting_m == pytest.approx(second.fix.position.easting_m, abs=0.1)


@pytest.mark.long
def test_the_command_ends_with_3_if_the_last_bundle_leaves_two_places(scene, drive, run, tmp_path):
    picture = tmp_path / "track.png"
    status, out, err = run(*drive, "--dem", scene.dem_path, "--plot", picture)
    assert (status, err) == (3, "")
    assert "stop-0  ambiguous" in out
    assert "stop-1  ambiguous" in out
    assert "2 places" in out
    assert "ambiguous: several places fit" in out.splitlines()[3 + 1]
    assert cv2.imread(str(picture)).shape[1] > 1000


def test_bad_input_is_one_line_and_status_2(scene, drive, run, tmp_path):
    dem = "--dem", scene.dem_path
    for arguments, words in (
        ((*drive, *dem, "--odometry", legs_file(tmp_path, EAST_200_M, EAST_200_M)), "has 2 legs"),
        ((*drive, *dem, "--odometry", tmp_path / "nothing"), "No such file"),
        ((drive[0], drive[0], *dem), "stop-0: is named twice"),
        ((drive[0], tmp_path / "gone", *dem), "does not exist"),
        ((*drive, *dem, "--plot", tmp_path / "track.xyz"), "no picture format"),
        ((*dem,), "Missing argument"),
    ):
        status, out, err = run(*arguments)
        assert (status, out) == (2, "")
        assert err.count("\n") == 1
        assert words in err


@pytest.mark.long
def test_bundles_named_against_their_times_are_noted(scene, drive, run):
    _, _, err = run(*reversed(drive), "--dem", scene.dem_path)
    assert err == (
        "localizer: bundle stop-0 was taken before stop-1, which is named before it; "
        "the odometry is taken in the order of the names\n"
    )
