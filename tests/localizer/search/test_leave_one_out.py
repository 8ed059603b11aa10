"""Which frames are suspected, and when the answer without one of them replaces the first."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from seen_from import Lens

from localizer.observation import FrameObservation, Observation
from localizer.search import leave_one_out
from localizer.search.answer import Located
from localizer.search.decide import Decision, no_place
from localizer.search.leave_one_out import check_frames, frame_agreement
from localizer.search.reasons import no_skyline
from localizer.search.stage1 import Stage1

LENS = Lens(100, 100, 1000.0, 1000.0, 49.5, 49.5, (0.0,) * 5)


def frame(label: str, points: int = 100, **changes: object) -> FrameObservation:
    seen = FrameObservation(
        label=label,
        camera=LENS,
        azimuth_deg=0.0,
        azimuth_sigma_deg=0.0,
        tilt_deg=0.0,
        tilt_sigma_deg=0.0,
        roll_deg=0.0,
        roll_sigma_deg=0.0,
        u_px=np.linspace(0.0, 99.0, points),
        v_px=np.full(points, 49.5),
        sigma_px=np.full(points, 1.0),
    )
    return dataclasses.replace(seen, **changes)


def observation(labels: str, blind: str = "") -> Observation:
    frames = tuple(frame(label, points=1 if label in blind else 2) for label in labels)
    return Observation(frames, 2.0, None, np.inf, 1.0, 0.02)


STAGE1 = Stage1(1, {"altitude": np.zeros((1, 2), np.int64)}, 0)


def answer(
    name: str,
    status: str = "fix",
    at: tuple[float, float] = (10.0, 10.0),
    *,
    evidence: float = 60.0,
    inliers: float = 0.9,
) -> Located:
    best = SimpleNamespace(name=name, row=at[0], col=at[1], evidence=evidence, inlier_share=inliers)
    return Located(Decision(status, [best], np.array([1.0]), 0.0, None), best, STAGE1, {})  # type: ignore[arg-type]


NONE = Located(no_place(no_skyline()), None, STAGE1, {})


@pytest.fixture
def checked(monkeypatch):
    """``check_frames``, with the frames' agreement by the name of the place, and the answers without each frame."""

    def of(labels, first, agreement, without, blind=""):
        tried = []
        monkeypatch.setattr(
            leave_one_out,
            "frame_agreement",
            lambda terrain, frame, place: agreement[place.name].get(frame.label),
        )

        def search(seen: Observation) -> Located:
            (label,) = set(labels) - {frame.label for frame in seen.frames}
            tried.append(label)
            return without.get(label, NONE)

        found = check_frames(SimpleNamespace(exact=False), observation(labels, blind), first, search)  # type: ignore[arg-type]
        return found, tried

    return of


ALL = {"N": 0.95, "E": 0.95, "S": 0.95, "W": 0.95}
E_IS_WRONG = {**ALL, "E": 0.1}


def test_frames_that_agree_with_a_fix_are_not_suspected(checked):
    found, tried = checked("NESW", answer("first"), {"first": ALL}, {})
    assert (found.left_out, tried) == (None, [])
    assert found.agreement == ALL


@pytest.mark.parametrize(("share", "suspected"), [(0.399, True), (0.4, False)])
def test_a_frame_of_a_fix_is_suspected_below_four_tenths(checked, share, suspected):
    _, tried = checked("NESW", answer("first"), {"first": {**ALL, "S": share}}, {})
    assert tried == (["S"] if suspected else [])


def test_of_an_answer_that_is_no_fix_the_two_frames_that_fit_worst_are_suspected(checked):
    shares = {"N": 0.9, "E": 0.7, "S": 0.8, "W": 0.95}
    _, tried = checked("NESW", answer("first", "ambiguous"), {"first": shares}, {})
    assert tried == ["E", "S"]


def test_without_a_place_every_frame_is_suspected_if_there_are_no_more_than_six(checked):
    assert checked("ABCDEF", NONE, {}, {})[1] == list("ABCDEF")
    assert checked("ABCDEFG", NONE, {}, {})[1] == []


def test_of_two_frames_neither_can_be_the_wrong_one(checked):
    assert checked("NE", NONE, {}, {})[1] == []
    assert checked("NES", NONE, {}, {}, blind="S")[1] == [], "a frame with one point sees nothing"
    assert checked("NES", NONE, {}, {})[1] == ["N", "E", "S"]


def test_a_frame_that_sees_nothing_has_no_agreement(checked):
    found, _ = checked("NESW", answer("first"), {"first": ALL}, {}, blind="S")
    assert set(found.agreement) == {"N", "E", "W"}


def test_an_answer_without_a_frame_replaces_the_first_if_that_frame_alone_contradicts_it(checked):
    found, tried = checked("NESW", NONE, {"second": E_IS_WRONG}, {"E": answer("second")})
    assert tried == ["N", "E", "S", "W"]
    assert (found.left_out, found.located.best.name) == ("E", "second")
    assert found.agreement == E_IS_WRONG


@pytest.mark.parametrize(
    "agreement",
    [
        ALL,  # the frame left out agrees, too
        {**E_IS_WRONG, "S": 0.3},  # another one contradicts
        {label: share for label, share in ALL.items() if label != "E"},  # the frame left out cannot be judged
    ],
)
def test_it_does_not_replace_it_otherwise(checked, agreement):
    found, _ = checked("NESW", NONE, {"second": agreement}, {"E": answer("second")})
    assert (found.left_out, found.located) == (None, NONE)


TRIED = np.log(4.0)


@pytest.mark.parametrize(
    ("second", "replaces"),
    [
        (
            answer("second", evidence=25.0 + TRIED + 0.001),
            True,
        ),  # each frame that is tried is one more chance
        (answer("second", evidence=25.0 + TRIED - 0.001), False),
        (answer("second", inliers=0.75), True),
        (answer("second", inliers=0.749), False),
        (answer("second", "ambiguous"), False),
    ],
)
def test_the_answer_without_a_frame_has_to_be_better_than_one_of_all(checked, second, replaces):
    found, _ = checked("NESW", NONE, {"second": E_IS_WRONG}, {"E": second})
    assert (found.left_out == "E") == replaces


@pytest.mark.parametrize(("apart_cells", "agree"), [(4.9, True), (5.1, False)])
def test_answers_without_different_frames_have_to_be_one_place(checked, apart_cells, agree):
    without = {
        "N": answer("north", evidence=50.0),
        "E": answer("east", at=(10.0, 10.0 + apart_cells), evidence=70.0),
    }
    shares = {"north": {**ALL, "N": 0.1}, "east": E_IS_WRONG}
    found, _ = checked("NESW", NONE, shares, without)
    assert found.left_out == ("E" if agree else None)


# ---- how a frame agrees


FAR_M = 10_000.0


@pytest.fixture
def agreement(monkeypatch):
    """Of a flat contour with a horizon that is predicted at an elevation (deg) and a distance, for all azimuths."""

    def of(
        seen: FrameObservation,
        elevation_deg,
        *,
        distance_m: np.ndarray | float = FAR_M,
        edge: np.ndarray | bool = False,
        dem_error_m: float = 0.0,
        nominal_m: float = 0.0,
        **place,
    ):
        monkeypatch.setattr(
            leave_one_out,
            "horizon",
            lambda terrain, row, col, altitude_m, azimuth_deg: (
                np.array([elevation_deg(azimuth_deg)]) + np.zeros((1, len(azimuth_deg))),
                np.array([distance_m + np.zeros(len(azimuth_deg))]),
            ),
        )
        monkeypatch.setattr(
            leave_one_out, "at_dem_edge", lambda terrain, row, col, azimuth, distance: edge & (distance > 0.0)
        )
        biases = {"azimuth_bias_deg": 0.0, "tilt_bias_deg": 0.0, **place}
        best = SimpleNamespace(row=0.0, col=0.0, altitude_m=0.0, dem_error_m=dem_error_m, **biases)
        terrain = SimpleNamespace(near_m=60.0, nominal_error_m=nominal_m)
        return frame_agreement(terrain, seen, best)  # type: ignore[arg-type]

    return of


def level(off_mrad: float):
    """A horizon that is off by as much in all directions."""
    return lambda azimuth_deg: np.degrees(off_mrad * 1e-3)


@pytest.mark.parametrize(
    ("fields", "errors", "three_sigma_mrad"),
    [
        ({}, {}, 3.0),  # a pixel
        ({"tilt_sigma_deg": np.degrees(2e-3)}, {}, 3.0 * np.hypot(1.0, 2.0)),
        ({}, {"dem_error_m": 20.0}, 3.0 * np.hypot(1.0, 2.0)),  # 20 m at 10 km
        ({}, {"dem_error_m": 1.0, "nominal_m": 100.0}, 3.0 * np.hypot(1.0, 3.0)),  # 0.3 of the nominal one
    ],
)
def test_a_column_fits_within_three_sigma_of_all_errors(agreement, fields, errors, three_sigma_mrad):
    for factor, share in ((0.99, 1.0), (1.01, 0.0)):
        for sign in (-1.0, 1.0):
            seen = frame("N", **fields)
            assert agreement(seen, level(sign * factor * three_sigma_mrad), **errors) == share


def test_the_roll_counts_by_the_distance_from_the_middle(agreement):
    """0.05 rad of roll at 40 px of 1000 are 2 mrad: there three sigma are 6.7 mrad, in the middle 3."""
    seen = frame("N", roll_sigma_deg=np.degrees(0.05))
    share = agreement(seen, level(6.7))
    assert share == pytest.approx(0.2, abs=0.02)  # 40 to 49.5 px on either side, of 100


def test_the_azimuth_counts_by_the_slope_of_the_horizon(agreement):
    """A slope of 1 and 2 mrad of azimuth; off by 6.6 mrad, of three times 2.236."""
    seen = frame("N", azimuth_sigma_deg=np.degrees(2e-3))

    def off(off_mrad: float):
        return lambda azimuth: azimuth + np.degrees(off_mrad * 1e-3)

    rows = 49.5 - (np.linspace(0.0, 99.0, 100) - 49.5)  # the contour rises to the right as the horizon does
    seen = dataclasses.replace(seen, v_px=rows)
    assert agreement(seen, off(6.6)) == 1.0
    assert agreement(seen, off(6.9)) == 0.0


@pytest.mark.parametrize("rising", [True, False])
@pytest.mark.parametrize(("sigma_mrad", "share"), [(5.0, 0.1), (0.0, 0.0)])
def test_beside_a_cliff_either_height_fits_as_far_as_the_azimuth_is_uncertain(
    agreement, rising, sigma_mrad, share
):
    """The contour is 10 mrad too high everywhere; within 5 mrad, five columns, on either side of a cliff of 0.1 rad it fits."""
    cliff = lambda azimuth_deg: np.degrees(0.1 * ((azimuth_deg > 0.0) == rising))  # noqa: E731
    high = 49.5 - 1000.0 * np.tan(0.01 + 0.1 * ((np.arange(100) > 49.5) == rising))
    seen = frame("N", azimuth_sigma_deg=np.degrees(sigma_mrad * 1e-3), v_px=high)
    assert agreement(seen, cliff) == pytest.approx(share, abs=0.001)


def test_the_biases_of_the_place_are_taken_off_the_readings(agreement):
    seen = frame("N", azimuth_deg=10.0, tilt_deg=2.0)
    asked = []
    assert agreement(
        seen,
        lambda azimuth: asked.append(np.median(azimuth)) or 0.0,
        azimuth_bias_deg=10.0,
        tilt_bias_deg=2.0,
    ) == pytest.approx(1.0)
    assert asked[0] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(("columns", "judged"), [(20, True), (19, False)])
def test_twenty_columns_that_are_neither_near_nor_at_the_edge_are_judged(agreement, columns, judged):
    distance_m = np.where(np.arange(100) < columns, FAR_M, 59.0)
    assert agreement(frame("N"), lambda azimuth: 0.0, distance_m=distance_m) == (1.0 if judged else None)
    edge = np.arange(100) >= columns
    assert agreement(frame("N"), lambda azimuth: 0.0, edge=edge) == (1.0 if judged else None)


def test_only_those_columns_count(agreement):
    distance_m = np.where(np.arange(100) < 50, FAR_M, 59.0)
    high_where_near = lambda azimuth: np.where(azimuth < 0.0, 0.0, 5.0)  # noqa: E731
    assert agreement(frame("N"), high_where_near, distance_m=distance_m) == 1.0
