"""A bundle, its contours, and the first step of a track come to the same fix."""

from pathlib import Path

import pytest

import localizer

pytestmark = pytest.mark.long


def answer(fix: localizer.Fix) -> dict[str, object]:
    """What is said of the place."""
    return fix.model_dump(exclude={"bundle", "timing_s"})


def test_a_bundle_and_its_contours_come_to_the_same(drive: Path, result: localizer.LocateResult) -> None:
    dem, bundle = (
        localizer.load_dem(drive / "terrain.tif"),
        localizer.load_bundle(drive / "bundles" / "first"),
    )
    of_contours = localizer.locate(localizer.observation_from_bundle(bundle), dem)
    assert answer(of_contours.fix) == answer(result.fix)
    for one, other in zip(of_contours.details.frames, result.details.frames, strict=True):
        assert one.agreement == other.agreement
        assert one.errors_deg == other.errors_deg


def test_the_first_step_of_a_track_comes_to_the_same(drive: Path, result: localizer.LocateResult) -> None:
    dem, bundle = (
        localizer.load_dem(drive / "terrain.tif"),
        localizer.load_bundle(drive / "bundles" / "first"),
    )
    step = localizer.Tracker().step(bundle, dem)
    assert answer(step.fix) == answer(result.fix)
    assert [h.probability for h in step.hypotheses] == pytest.approx(
        [c.probability for c in result.fix.candidates], abs=1e-3
    )
