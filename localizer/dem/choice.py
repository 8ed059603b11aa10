"""Elevation files with the properties that a user declares for them."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import click

if TYPE_CHECKING:
    from localizer.dem.lattice import Dem


@dataclass(frozen=True)
class DemChoice:
    """Elevation files with the properties that a user declares, which take precedence over the files' own."""

    paths: tuple[Path, ...]
    vertical_unit: str | None = None
    crs: str | None = None
    nodata: float | None = None
    error_m: float | None = None
    band: int | None = None
    scale: float | None = None
    geoid_offset_m: float | None = None

    def to_fields(self) -> dict[str, Any]:
        """As JSON has it, for another process."""
        return asdict(self) | {"paths": [str(path) for path in self.paths]}

    @classmethod
    def from_fields(cls, fields: dict[str, Any]) -> Self:
        """What ``to_fields`` gave."""
        return cls(**fields | {"paths": tuple(Path(path) for path in fields["paths"])})

    def load(self) -> "Dem":
        """Read them. Raises ``DemError``."""
        from localizer.dem.lattice import load_dem  # slow to import; bad usage is reported first

        return load_dem(
            self.paths,
            vertical_unit=self.vertical_unit,
            crs=self.crs,
            nodata=self.nodata,
            error_m=self.error_m,
            band=self.band,
            scale=self.scale,
            geoid_offset_m=self.geoid_offset_m,
        )

    def load_to_search(self, program: str) -> "Dem":
        """Read them, and print the notes for users on standard error. Raises ``DemError``."""
        from localizer.dem.info import dem_notes

        dem = self.load()
        for note in dem_notes(dem):
            click.echo(f"{program}: {note}", err=True)
        return dem
