"""The tables of a report's page."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from localizer.bundle import Bundle
from localizer.observation import NO_COMPASS_SIGMA_DEG
from localizer.search.details import INCONSISTENT_BELOW, FrameDetail, LocateResult, SolvedErrors
from localizer.show.candidates import CandidatePlace

FAR_SIGMAS = 3.0


@dataclass(frozen=True)
class Cell:
    """One entry of a table, as it is shown."""

    text: str
    far: bool = False
    """Whether the value is unusual and highlighted."""


@dataclass(frozen=True)
class Table:
    """Heads and rows of as many cells each."""

    heads: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    text_columns: frozenset[int]
    """Columns with text instead of numbers."""


def _table(heads: Sequence[str], rows: Iterable[Sequence[Cell | str]], words: Iterable[int] = (0,)) -> Table:
    return Table(
        tuple(heads),
        tuple(tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in row) for row in rows),
        frozenset(words),
    )


def place_table(places: Sequence[CandidatePlace]) -> Table:
    """Every place by rank."""
    return _table(
        ("rank", "probability", "latitude", "longitude", "easting", "northing", "1 sigma", "towards", "rms"),
        (
            (
                str(place.rank),
                f"{place.probability:.4f}",
                f"{place.lat_deg:.6f}°",
                f"{place.lon_deg:.6f}°",
                f"{place.easting_m:.1f}",
                f"{place.northing_m:.1f}",
                f"{place.axes.major_m:.1f} x {place.axes.minor_m:.1f} m",
                f"{place.azimuth_deg:.0f}°",
                f"{place.rms_px:.2f} px",
            )
            for place in places
        ),
    )


def stage1_table(result: LocateResult) -> Table:
    """Cells left after each step of the first stage, as in the paper's Table I."""
    stage1 = result.fix.stage1
    steps = [
        ("elevation known", stage1.cells),
        ("altitude", stage1.after_altitude),
        *((f"frame {label}", left) for label, left in stage1.after.items()),
    ]
    rows = []
    for i, (name, left) in enumerate(steps):
        before = steps[i - 1][1] if i else left
        rows.append(
            (
                name,
                f"{left:,}",
                f"{100.0 * left / stage1.cells:.3g} %" if stage1.cells else "",
                f"{100.0 * left / before:.3g} %" if i and before else "",
            )
        )
    return _table(("after", "cells left", "of all", "of the step before"), rows)


def bias_table(result: LocateResult, bundle: Bundle) -> Table | None:
    """Errors that all frames share; None without a place."""
    nuisance, errors = result.fix.nuisance, result.details.errors
    if nuisance is None:
        return None
    azimuth_sigma_deg: float | None = bundle.azimuth_bias_sigma_deg
    if bundle.azimuth_bias_sigma_deg >= NO_COMPASS_SIGMA_DEG:
        azimuth_sigma_deg = None
    rows = [
        _row("azimuth, all frames", nuisance.azimuth_bias_deg, azimuth_sigma_deg, "°", 3),
        _row("tilt, all frames", nuisance.tilt_bias_deg, bundle.tilt_bias_sigma_deg, "°", 3),
    ]
    if bundle.altitude is not None:
        rows.append(_row("altitude", nuisance.altitude_bias_m, bundle.altitude.sigma_m, " m", 1))
    if errors is not None:
        rows.append(
            ("altitude of the camera, solved for", Cell(f"{errors.altitude_m:.1f} m"), Cell(""), Cell(""))
        )
    return _table(("quantity", "error", "sensor's sigma", "in sigmas"), rows)


def _row(
    name: str, error: float, sigma: float | None, unit: str, digits: int
) -> tuple[str, Cell, Cell, Cell]:
    known = sigma is not None and sigma > 0.0
    return (
        name,
        Cell(f"{error:+.{digits}f}{unit}"),
        Cell("unknown" if sigma is None else f"{sigma:.{digits}f}{unit}"),
        _sigmas(error, sigma) if known and sigma is not None else Cell(""),
    )


def _sigmas(error: float, sigma: float) -> Cell:
    sigmas = error / sigma
    return Cell(f"{sigmas:+.1f}", far=abs(sigmas) > FAR_SIGMAS)


def frame_table(result: LocateResult, bundle: Bundle) -> Table:
    """For each frame: the shares of the skyline found, used and explained, and the frame's own errors."""
    rows: list[tuple[Cell | str, ...]] = []
    for detail, frame in zip(result.details.frames, bundle.frames, strict=True):
        width_px = bundle.camera.height_px if detail.quarter_turns % 2 else bundle.camera.width_px
        residual_px = result.fix.residual.get(frame.label)
        row: list[Cell | str] = [
            frame.label,
            f"{100.0 * len(detail.found_u_px) / width_px:.0f} %",
            Cell(f"{100.0 * np.count_nonzero(detail.used) / width_px:.0f} %", far=not detail.used.any()),
            _agreement(detail),
            "" if residual_px is None else f"{residual_px:.2f} px",
        ]
        sigmas = (frame.azimuth_sigma_deg, frame.tilt_sigma_deg, frame.roll_sigma_deg)
        for error_deg, sigma_deg in zip(detail.errors_deg or (None,) * 3, sigmas, strict=True):
            if error_deg is None:
                row.append("")
                continue
            in_sigmas = f" ({error_deg / sigma_deg:+.1f})" if sigma_deg > 0.0 else ""
            far = sigma_deg > 0.0 and abs(error_deg / sigma_deg) > FAR_SIGMAS
            row.append(Cell(f"{error_deg:+.3f}°{in_sigmas}", far=far))
        rows.append(tuple(row))
    return _table(
        (
            "frame",
            "columns with a skyline",
            "columns used",
            "fits",
            "residual, rms",
            "azimuth error (sigmas)",
            "tilt error (sigmas)",
            "roll error (sigmas)",
        ),
        rows,
    )


def _agreement(frame: FrameDetail) -> Cell:
    if frame.agreement is None:
        return Cell("left out" if frame.left_out else "", far=frame.left_out)
    share = f"{100.0 * frame.agreement:.0f} %"
    return Cell(f"{share}, left out" if frame.left_out else share, far=frame.agreement < INCONSISTENT_BELOW)


def fit_table(errors: SolvedErrors) -> Table:
    """DEM error and goodness of fit, by the residuals."""
    return _table(
        ("quantity", "value", "what it means"),
        (
            (
                "error of the elevation model",
                f"{errors.dem_error_m:.1f} m",
                "one standard deviation of the ridges' elevations, estimated from the residuals"
                if errors.dem_error_m > 0.0
                else "declared exact, and it fits",
            ),
            (
                "correlation",
                f"{errors.correlation_columns:.1f} columns",
                "columns per effective sample: neighbouring columns are correlated",
            ),
            (
                "columns that fit",
                f"{100.0 * errors.inlier_share:.0f} %",
                "share within three standard deviations; the rest shows something else than terrain, or terrain "
                "that the model lacks",
            ),
            (
                "normalised errors of the readings",
                f"{errors.prior_chi2:.1f}",
                "sum of the squared errors of all sensors, each in its own standard deviations",
            ),
            (
                "evidence",
                f"{errors.evidence:.0f}",
                "log Bayes factor: how much better the place explains the skylines than an unrelated one does",
            ),
        ),
        (0, 2),
    )


def bundle_table(bundle: Bundle) -> Table:
    """The readings that all frames share."""
    camera, altitude, prior = bundle.camera, bundle.altitude, bundle.prior
    compass = (
        "none"
        if bundle.azimuth_bias_sigma_deg >= NO_COMPASS_SIGMA_DEG
        else f"sigma of the bias {bundle.azimuth_bias_sigma_deg:g}°"
    )
    rows = [
        ("altitude", "none" if altitude is None else f"{altitude.value_m:.1f} m ± {altitude.sigma_m:.1f} m"),
        ("heading", compass),
        ("tilt", f"sigma of the bias {bundle.tilt_bias_sigma_deg:g}°"),
        ("mast height", f"{bundle.mast_height_m:g} m"),
        (
            "camera",
            f"{camera.width_px} x {camera.height_px} px, fx {camera.fx_px:.1f}, fy {camera.fy_px:.1f}, "
            f"cx {camera.cx_px:.1f}, cy {camera.cy_px:.1f}, "
            f"distortion {', '.join(f'{value:g}' for value in camera.distortion)}",
        ),
        (
            "known beforehand",
            "nothing"
            if prior is None
            else f"within {prior.radius_m:g} m of {prior.lat_deg:.5f}°, {prior.lon_deg:.5f}°",
        ),
    ]
    return _table(("reading", ""), rows, (0, 1))


def reading_table(bundle: Bundle) -> Table:
    """Where the camera pointed, by its sensors."""
    return _table(
        ("frame", "time", "azimuth", "tilt", "roll", "file"),
        (
            (
                frame.label,
                f"{frame.time:%H:%M:%S}Z",
                f"{frame.azimuth_deg:.3f}° ± {frame.azimuth_sigma_deg:g}°",
                f"{frame.tilt_deg:+.3f}° ± {frame.tilt_sigma_deg:g}°",
                f"{frame.roll_deg:+.3f}° ± {frame.roll_sigma_deg:g}°",
                frame.file,
            )
            for frame in bundle.frames
        ),
        (0, 5),
    )


def timing_table(timing_s: dict[str, float]) -> Table:
    """Seconds in each part, and together."""
    rows = [(part, f"{seconds:.3f} s") for part, seconds in timing_s.items()]
    return _table(("part", "time"), [*rows, ("together", f"{sum(timing_s.values()):.3f} s")])
