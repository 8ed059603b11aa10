"""A track settles on one place where a single look cannot, and never hands out an old place as a new one.

Three craters that look alike: a hillock near the eastern spot tells craters 0 and 2 from crater 1 there, and one near the
western spot tells crater 2 from the others there. From either spot alone two craters remain; only the way between them says
which. The contours come from the simulator's own surface.
"""

import dataclasses
import functools
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from affine import Affine

from localizer.bundle import Bundle, Camera, Frame, sha256_of
from localizer.commands import cli
from localizer.dem.geodesy import rowcol_to_lonlat
from localizer.dem.horizon import Terrain, prepare_terrain
from localizer.dem.lattice import load_dem
from localizer.observation import Observation, PriorCircle
from localizer.search.locate import locate
from localizer.track import Movement, Tracker, follow
from localizer.track.document import TrackLine
from localizer.track.tracker import TrackerError
from sim.paper.observations import aimed_tilt_deg, frame_observation, half_view_deg
from sim.world.contour import skyline_contour
from sim.world.mechanics import Attitude, camera_in_world
from sim.world.scenario import CameraOptics
from sim.world.surface import Surface
from sim.world.terrain import read_terrain

CELL_M = 30.0
SIDE = 96
CRATERS = 3
WEST_SPOT = (50.0, 44.0)
STEP_CELLS = 200.0 / CELL_M
EAST_SPOT = (WEST_SPOT[0], WEST_SPOT[1] + STEP_CELLS)
EAST_HILLOCK = (EAST_SPOT[0] - 1.0, EAST_SPOT[1] + 4.0)
WEST_HILLOCK = (WEST_SPOT[0] + 1.0, WEST_SPOT[1] - 4.0)
MAST_M = 2.0
OPTICS = CameraOptics(distortion=(0.0, 0.0, 0.0, 0.0, 0.0))


def crater(hillocks: list[tuple[float, float]]) -> np.ndarray:
    """Elevations (SIDE, SIDE): a ragged rim, the same each time, around ground that slopes gently."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    y, x = row - SIDE / 2, col - SIDE / 2
    angle, radius = np.arctan2(y, x), np.hypot(y, x)
    rim_m = (
        420.0 + 20.0 * np.sin(3 * angle + 1.0) + 15.0 * np.sin(7 * angle) + 10.0 * np.sin(13 * angle + 2.0)
    )
    z = 500.0 + 0.4 * x - 0.3 * y + rim_m * np.exp(-(((radius - 40.0) / 4.0) ** 2))
    for at in hillocks:
        z += 60.0 * np.exp(-((row - at[0]) ** 2 + (col - at[1]) ** 2) / 2.0)
    return z


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    dem_path: Path
    terrain: Terrain
    surface: Surface

    @functools.cache  # noqa: B019 - one scene lives as long as the module
    def look(self, number: int, spot: tuple[float, float], azimuths=(0.0, 90.0, 180.0, 270.0), seed=0):
        """What the rig observes at a spot of a crater; the same object for the same one."""
        rng = np.random.default_rng([seed, number, int(spot[1])])
        place = (spot[0], spot[1] + number * SIDE)
        eye_m = self.surface.height(*place) + MAST_M
        observer = self.surface.observer(*place, eye_m)
        columns_px = np.arange(float(OPTICS.width_px))
        frames = []
        for azimuth_deg in azimuths:
            tilt_deg = aimed_tilt_deg(self.surface, observer, azimuth_deg, half_view_deg(OPTICS))
            contour = skyline_contour(
                self.surface, observer, OPTICS, camera_in_world(azimuth_deg, tilt_deg, 0.0), columns_px
            )
            frames.append(
                frame_observation(
                    f"{azimuth_deg:.0f}",
                    OPTICS,
                    Attitude(azimuth_deg, tilt_deg, 0.0),
                    (0.1, 0.01, 0.02),
                    columns_px,
                    contour + rng.normal(0.0, 0.5, len(contour)),
                    0.5,
                )
            )
        return Observation(tuple(frames), MAST_M, eye_m, 5.0, 0.5, 0.02)

    def error_cells(self, fix, number: int, spot: tuple[float, float]) -> float:
        return float(np.hypot(fix.position.row - spot[0], fix.position.col - spot[1] - number * SIDE))


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Scene:
    z_m = np.hstack([crater([EAST_HILLOCK]), crater([]), crater([EAST_HILLOCK, WEST_HILLOCK])])
    path = tmp_path_factory.mktemp("craters") / "craters.tif"
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": "EPSG:32610"}
    transform = Affine(CELL_M, 0.0, 500_000.0, 0.0, -CELL_M, 4_600_000.0)
    with rasterio.open(
        path, "w", height=z_m.shape[0], width=z_m.shape[1], transform=transform, **profile
    ) as raster:
        raster.write(z_m.astype(np.float32), 1)
    return Scene(path, prepare_terrain(load_dem([path])), Surface(read_terrain([path])))


def driven(east_m: float, north_m: float = 0.0, sigma_m: float = 4.0) -> Movement:
    return Movement(np.array([east_m, north_m]), sigma_m**2 * np.eye(2))


def track(scene: Scene, *looks: tuple[Movement | None, Observation], tracker: Tracker | None = None):
    """Follows the looks and returns the steps."""
    steps = []
    tracker = tracker or Tracker()
    for number, (leg, observation) in enumerate(looks):
        steps.append(follow(tracker, leg, scene.terrain, observation, f"look {number}"))
        tracker = steps[-1].tracker
    return steps


@pytest.fixture(scope="module", autouse=True)
def searched_once():
    """The whole DEM is searched once for each look: the answer to an observation is always the same."""
    found = {}

    def locate_once(terrain: Terrain, observation: Observation, **options):
        key = id(terrain), id(observation), *options.items()
        if key not in found:
            found[key] = (observation, locate(terrain, observation, **options))  # kept alive, for its id
        return found[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("localizer.track.tracker.locate", locate_once)
        yield locate_once


@pytest.fixture(scope="module")
def west_alone(scene, searched_once):
    """What the search says of the western spot of crater 0."""
    return searched_once(scene.terrain, scene.look(0, WEST_SPOT))


@pytest.fixture(scope="module")
def first_steps(scene):
    """Of tracks that begin at the western spots of craters 0 and 2."""
    return {number: track(scene, (None, scene.look(number, WEST_SPOT)))[0] for number in (0, 2)}


def blinded(observation: Observation) -> Observation:
    """The same in fog."""
    empty = np.zeros(0)
    return dataclasses.replace(
        observation,
        frames=tuple(
            dataclasses.replace(f, u_px=empty, v_px=empty, sigma_px=empty) for f in observation.frames
        ),
    )


def test_a_program_steps_a_tracker(scene, first_steps):
    movement = driven(30.0)
    blind = blinded(scene.look(0, WEST_SPOT))
    step = first_steps[0].tracker.step(blind, scene.terrain.dem, movement=movement, name="in fog")
    expected = follow(first_steps[0].tracker, movement, scene.terrain, blind, "in fog")
    assert step.fix.status == "none"
    assert step.tracker == expected.tracker
    assert len(step.hypotheses) == len(expected.posteriors) > 1
    assert not any(hypothesis.seen for hypothesis in step.hypotheses)
    assert step.elsewhere == expected.elsewhere


def test_a_known_drive_of_200_m_resolves_what_neither_bundle_alone_can(
    scene, first_steps, west_alone, searched_once
):
    east = scene.look(0, EAST_SPOT)
    assert west_alone.decision.status == "ambiguous"
    assert searched_once(scene.terrain, east).decision.status == "ambiguous"
    first = first_steps[0]
    (second,) = track(scene, (driven(200.0), east), tracker=first.tracker)
    assert first.fix.status == "ambiguous"
    assert second.fix.status == "fix"
    assert scene.error_cells(second.fix, 0, EAST_SPOT) < 0.2
    assert second.fix.probability >= 0.99
    assert second.fix.candidates[0].probability == second.fix.probability


@pytest.mark.long
def test_an_unknown_drive_resolves_nothing(scene):
    steps = track(scene, (None, scene.look(0, WEST_SPOT)), (None, scene.look(0, EAST_SPOT)))
    assert [step.fix.status for step in steps] == ["ambiguous", "ambiguous"]
    assert [step.mode for step in steps] == ["whole DEM", "whole DEM"]


@pytest.mark.long
def test_odometry_that_fits_no_pair_of_places_resolves_nothing(scene):
    legs = driven(0.0, 200.0), scene.look(0, EAST_SPOT)
    *_, last = track(scene, (None, scene.look(0, WEST_SPOT)), legs)
    assert last.fix.status == "ambiguous"
    assert len(last.fix.candidates) == 2


def test_a_second_bundle_from_the_same_spot_resolves_nothing(scene, west_alone, monkeypatch):
    # whatever speaks for the one crater, an error of the DEM perhaps, speaks for it each time
    leaning = dataclasses.replace(
        west_alone, decision=dataclasses.replace(west_alone.decision, probabilities=np.array([0.8, 0.2]))
    )
    monkeypatch.setattr("localizer.track.tracker.locate", lambda terrain, observation, **_: leaning)
    looks = [(driven(0.0, sigma_m=0.1), scene.look(0, WEST_SPOT))] * 8
    for step in track(scene, *looks):
        assert step.fix.status == "ambiguous"
        assert step.fix.probability == pytest.approx(0.8, abs=0.01)


def test_the_first_bundle_gives_the_result_of_the_search_alone(first_steps, west_alone):
    step, best = first_steps[0], west_alone.best
    assert (step.fix.position.row, step.fix.position.col) == (best.row, best.col)
    assert step.mode == "whole DEM"


def test_a_track_with_one_place_searches_only_around_it(scene, first_steps):
    first = first_steps[2]
    (second,) = track(scene, (driven(200.0), scene.look(2, EAST_SPOT)), tracker=first.tracker)
    assert first.fix.status == "fix"
    assert second.mode == "bootstrap"
    assert second.fix.status == "fix"  # the search alone would not know which crater it is
    assert scene.error_cells(second.fix, 2, EAST_SPOT) < 0.2
    assert second.fix.stage1.after_altitude < 0.1 * first.fix.stage1.cells


def test_where_the_odometry_misleads_the_whole_dem_is_searched_and_the_history_dropped(scene, first_steps):
    # carried from crater 2 to crater 1, 2.7 km away, while the odometry tells of a short drive
    first = first_steps[2]
    (second,) = track(scene, (driven(200.0), scene.look(1, EAST_SPOT)), tracker=first.tracker)
    assert first.fix.status == "fix"
    assert second.mode == "whole DEM after bootstrap failed"
    assert second.fix.status == "fix"
    assert scene.error_cells(second.fix, 1, EAST_SPOT) < 0.2


@pytest.mark.long
def test_a_bundle_without_a_skyline_gives_none_and_the_track_goes_on(scene):
    fog = blinded(scene.look(2, WEST_SPOT))
    first, second, third = track(
        scene,
        (None, scene.look(2, WEST_SPOT)),
        (driven(120.0), fog),
        (driven(80.0), scene.look(2, EAST_SPOT)),
    )
    assert second.fix.status == "none"
    assert second.fix.position is None
    assert second.fix.candidates == ()
    kept = second.tracker.now.hypotheses
    assert len(kept) == len(first.tracker.now.hypotheses)
    assert kept[0].place.widest_m > first.tracker.now.hypotheses[0].place.widest_m
    assert kept[0].place.lon_deg > first.tracker.now.hypotheses[0].place.lon_deg
    assert (third.mode, third.fix.status) == ("bootstrap", "fix")
    assert scene.error_cells(third.fix, 2, EAST_SPOT) < 0.2


@pytest.mark.long
def test_a_bundle_without_a_skyline_keeps_several_hypotheses(scene):
    fog = blinded(scene.look(0, WEST_SPOT))
    *_, last = track(
        scene,
        (None, scene.look(0, WEST_SPOT)),
        (driven(120.0), fog),
        (driven(80.0), scene.look(0, EAST_SPOT)),
    )
    assert last.fix.status == "fix"
    assert scene.error_cells(last.fix, 0, EAST_SPOT) < 0.2


@pytest.mark.long
def test_a_track_goes_on_from_its_stored_state_as_if_it_had_not_stopped(scene):
    west, east = scene.look(0, WEST_SPOT), scene.look(0, EAST_SPOT)
    first, through = track(scene, (None, west), (driven(200.0), east))
    stored = Tracker.from_json(first.tracker.to_json())
    assert stored == first.tracker
    (resumed,) = track(scene, (driven(200.0), east), tracker=stored)
    assert resumed.fix.position == through.fix.position
    assert resumed.tracker == through.tracker


@pytest.mark.parametrize(
    "text", ["", "{}x", '{"schema": "skyfix.tracker/2"}', '{"now": {"hypotheses": [1]}}']
)
def test_a_state_that_is_none_is_refused_in_one_line(text):
    with pytest.raises(TrackerError, match="state of a track") as refusal:
        Tracker.from_json(text)
    assert "\n" not in str(refusal.value)


def test_the_bundles_own_prior_limits_the_search_of_the_whole_dem(scene):
    lon_deg, lat_deg = rowcol_to_lonlat(scene.terrain.dem, WEST_SPOT[0], WEST_SPOT[1] + SIDE)
    prior = PriorCircle(float(lat_deg), float(lon_deg), 800.0)
    (step,) = track(scene, (None, dataclasses.replace(scene.look(0, WEST_SPOT), prior=prior)))
    assert step.fix.status == "fix"
    assert scene.error_cells(step.fix, 1, WEST_SPOT) < 0.2


# ---- the command


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
