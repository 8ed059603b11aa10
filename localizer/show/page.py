"""The HTML report: one self-contained file."""

from base64 import b64encode
from collections.abc import Mapping, Sequence

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from localizer.bundle import Bundle
from localizer.dem.crs import readable_name
from localizer.dem.info import dem_notes
from localizer.dem.lattice import Dem
from localizer.fix import Fix, Status, lat_lon
from localizer.search.details import LocateResult
from localizer.show.candidates import CandidatePlace
from localizer.show.figures import (
    MOST_DETAIL_MAPS,
    frame_picture,
    map_picture,
    posterior_picture,
    stage1_maps,
)
from localizer.show.posterior import Posterior
from localizer.show.tables import (
    bias_table,
    bundle_table,
    fit_table,
    frame_table,
    place_table,
    reading_table,
    stage1_table,
    timing_table,
)
from localizer.show.text import notes, sigmas_off
from localizer.truth import Truth

MEANING: dict[Status, str] = {
    "fix": "One place stands out: from there the terrain has the skyline of the frames, and from nowhere else in this "
    "elevation model.",
    "ambiguous": "Several places fit, or one that is poorly known. None of them is to be trusted alone; frames in more "
    "directions, a better heading or altitude, or a rough place known beforehand can decide.",
    "none": "The frames fit no place in this elevation model, say because it does not cover the place, or because what "
    "was taken for the skyline is none.",
}


def page(
    bundle: Bundle,
    images: Mapping[str, NDArray[np.uint8]],
    result: LocateResult,
    dem: Dem,
    places: Sequence[CandidatePlace],
    posterior: Posterior | None,
    files: Sequence[tuple[str, str]],
    truth: Truth | None = None,
    missing: Sequence[str] = (),
) -> str:
    """The HTML of a report.

    ``images``: each frame's picture, BGR, by label. ``posterior``: None where there is no place. ``files``: name and
    contents of what lies beside the page; ``missing`` says what of it could not be made.
    """
    fix = result.fix
    template = Environment(
        loader=PackageLoader("localizer", "show"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    ).get_template("report.html.j2")
    frames = [
        {
            "label": detail.label,
            "image": _base64(frame_picture(images[detail.label], detail, fix.residual.get(detail.label))),
            "left_out": detail.left_out,
            "caption": f"{detail.label}: azimuth {frame.azimuth_deg:.2f}°, tilt {frame.tilt_deg:+.2f}°, "
            f"roll {frame.roll_deg:+.2f}° by the sensors; {np.count_nonzero(detail.used)} of "
            f"{bundle.camera.width_px} columns used",
        }
        for detail, frame in zip(result.details.frames, bundle.frames, strict=True)
    ]
    return template.render(
        fix=fix,
        headline=_headline(fix),
        meaning=MEANING[fix.status],
        facts=_facts(result, dem, places, truth),
        warnings=[*dem_notes(dem), *notes(result, bundle, dem), *missing],
        taken=f"{bundle.created:%Y-%m-%d %H:%M:%S} UTC",
        dem_text=_dem_text(dem),
        files=[{"name": name, "what": what} for name, what in files],
        frames=frames,
        places=places,
        truth=truth,
        map=_base64(map_picture(result, places, dem, truth)),
        stage1_maps=_base64(stage1_maps(result, dem)),
        posterior=_base64(posterior_picture(places, posterior, dem, truth)) if posterior else None,
        posterior_sum=posterior.total if posterior else 0.0,
        zoomed=MOST_DETAIL_MAPS,
        place_table=place_table(places) if places else None,
        stage1_table=stage1_table(result),
        bias_table=bias_table(result, bundle),
        frame_table=frame_table(result, bundle),
        fit_table=fit_table(result.details.errors) if result.details.errors else None,
        bundle_table=bundle_table(bundle),
        reading_table=reading_table(bundle),
        timing_table=timing_table(fix.timing_s),
        fix_json=fix.model_dump_json(by_alias=True, indent=2),
    )


def _headline(fix: Fix) -> str:
    if fix.position is None:
        return "no place in this elevation model"
    if fix.status == "fix":
        return lat_lon(fix.position)
    count = len(fix.candidates)
    return f"{count} places fit" if count > 1 else "one place fits, but it is poorly known"


def _facts(
    result: LocateResult, dem: Dem, places: Sequence[CandidatePlace], truth: Truth | None
) -> list[tuple[str, str]]:
    fix = result.fix
    if fix.position is None or not places:
        return []
    best, position = places[0], fix.position
    facts = [
        (
            f"easting, northing ({readable_name(dem.metric_crs)})",
            f"{position.easting_m:.1f}  {position.northing_m:.1f}",
        ),
        (
            f"1 sigma, the longer towards {best.azimuth_deg:.0f}°",
            f"{best.axes.major_m:.1f} m x {best.axes.minor_m:.1f} m",
        ),
        ("its probability" if fix.status == "ambiguous" else "probability", f"{fix.probability:.3f}"),
        ("ground", f"{position.ground_m:.1f} m"),
    ]
    if fix.status == "ambiguous":
        facts.insert(0, ("likeliest place", lat_lon(position)))
    if truth is not None:
        sigmas = "" if fix.covariance_m2 is None else f"  ({sigmas_off(fix, truth, dem):.1f} sigma)"
        facts.append(("true error", f"{truth.distance_m(position, dem):.1f} m{sigmas}"))
    return facts


def _dem_text(dem: Dem) -> str:
    names = ", ".join(path.name for path in dem.source)
    return (
        f"{names + ', ' if names else ''}{dem.rows} x {dem.cols} cells of {dem.spacing_ns_m:.1f} m x "
        f"{dem.spacing_ew_m:.1f} m, {dem.crs.name}"
    )


def _base64(content: bytes) -> str:
    return b64encode(content).decode("ascii")
