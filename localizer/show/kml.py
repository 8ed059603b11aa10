"""The places as placemarks of KML 2.2, for globes and maps."""

from collections.abc import Sequence

import simplekml

from localizer.bundle import Bundle
from localizer.dem.crs import wrapped_lon_deg
from localizer.fix import Fix
from localizer.show.candidates import CandidatePlace, place_description, place_name

DECIMALS = 7


def fix_kml(places: Sequence[CandidatePlace], fix: Fix, bundle: Bundle) -> str:
    """The fix alone; all candidates where the result is ambiguous. The points lie on the ground."""
    kml = simplekml.Kml(name=bundle.id)
    shown = places[:1] if fix.status == "fix" else places
    for place in shown:
        point = kml.newpoint(
            name=place_name(place, fix.status, len(shown), bundle.id),
            description=place_description(place, fix.status),
            coords=[(wrapped_lon_deg(round(place.lon_deg, DECIMALS)), round(place.lat_deg, DECIMALS))],
            altitudemode=simplekml.AltitudeMode.clamptoground,
        )
        point.timestamp.when = bundle.created.isoformat().replace("+00:00", "Z")
        for name, value in (
            ("status", fix.status),
            ("probability", f"{place.probability:.4f}"),
            ("sigma_major_m", f"{place.axes.major_m:.2f}"),
            ("sigma_minor_m", f"{place.axes.minor_m:.2f}"),
        ):
            point.extendeddata.newdata(name, value)
    text: str = kml.kml()
    return text
