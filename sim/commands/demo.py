"""``sim demo``: the whole chain as a user runs it: a simulated rig at a drawn place, a capture, a fix, and its error."""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from localizer.dem.ground import ground_offset_m, map_metres
from localizer.fix import Fix, ellipse
from localizer.show.text import CHI2_95
from localizer.truth import Truth
from sim.errors import SimulationError
from sim.launch.child_command import find_command, run_command
from sim.launch.launcher import simulated_rig
from sim.world.truth import World

WRONG_BEYOND_M = 30.0
"""One cell of the included terrain: a nearer fix is right whatever its sigma."""

WRONG_BEYOND_SIGMAS = 3.72
"""99.9 % of a normal distribution in the plane lies within this many sigmas."""

WRONG_FIX = 5
HONEST_EXITS = (0, 3, 4)  # of localizer locate: fix, ambiguous, none


class Claim(NamedTuple):
    """The stated uncertainty of a position, metres of the ground."""

    major_m: float
    """One standard deviation along the ellipse's longer axis."""
    minor_m: float
    azimuth_deg: float
    """Azimuth of the longer axis from true north, 0 to 180."""
    within_95_m: float
    """Half the length of the ellipse that holds 95 %."""


def claim_of(fix: Fix) -> Claim | None:
    """The stated uncertainty of a fix; None without a position."""
    if fix.position is None or fix.covariance_m2 is None:
        return None
    axes = ellipse(fix.covariance_m2)
    here = map_metres(fix.position.crs, fix.position.easting_m, fix.position.northing_m)
    azimuth_deg = (axes.grid_azimuth_deg + here.convergence_deg) % 180.0
    return Claim(axes.major_m, axes.minor_m, azimuth_deg, float(np.sqrt(CHI2_95)) * axes.major_m)


@dataclass(frozen=True)
class Outcome:
    """Result of the demo. ``error_m`` is None without a position."""

    fix: Fix
    error_m: float | None
    error_sigmas: float | None

    @property
    def claimed(self) -> Claim | None:
        """The stated uncertainty of the position."""
        return claim_of(self.fix)

    @property
    def wrong(self) -> bool:
        """Whether a wrong place has status ``fix``."""
        if self.fix.status != "fix" or self.error_m is None or self.error_sigmas is None:
            return False
        return self.error_m > WRONG_BEYOND_M and self.error_sigmas > WRONG_BEYOND_SIGMAS


def demo(world: World, dem_paths: Sequence[Path], out: Path, as_json: bool = False) -> int:
    """Capture with ``rig`` and locate with ``localizer``, both as subprocesses; returns the exit status.

    Writes the bundle, ``fix.json``, ``fix.png`` and ``truth.json`` into ``out``. Returns 0 if the answer is consistent
    with its stated uncertainty.

    Raises:
        SimulationError: ``rig`` or ``localizer`` is not installed, or a capture left no bundle.
    """
    bundles = out / "bundles"
    bundles.mkdir(parents=True, exist_ok=True)
    before = set(bundles.iterdir())
    _say("A rig is put somewhere on the terrain (the very first time compiles for a minute). Capture:")
    with simulated_rig(world) as rig:
        status = run_command(
            ["rig", "capture", "--out", str(bundles)], rig.environment, stdout=sys.stderr if as_json else None
        )
        if status:
            _say(f"rig capture ended with status {status}")
            return status
        new = set(bundles.iterdir()) - before
        if len(new) != 1:
            raise SimulationError(
                f"{bundles}: rig capture left {len(new)} bundles, not one; look at its messages"
            )
        (bundle,) = new
        truth = world.truth_json()
        _say(f"Where was {bundle} taken? Search:")
        picture = out / "fix.png"
        located = _locate(bundle, dem_paths, rig.truth_path, picture)
    if located.returncode not in HONEST_EXITS:
        _say(f"localizer locate ended with status {located.returncode}")
        return located.returncode
    (out / "fix.json").write_text(located.stdout, encoding="utf-8")
    (out / "truth.json").write_text(json.dumps(truth, indent=2), encoding="utf-8")
    outcome = judge(Fix.model_validate_json(located.stdout), truth)
    if as_json:
        print(json.dumps(_fields(outcome, truth, bundle, picture)))
    else:
        print(summary(outcome, truth))
        print(f"picture     {picture}")
    return WRONG_FIX if outcome.wrong else 0


def _locate(
    bundle: Path, dem_paths: Sequence[Path], truth_path: Path, picture: Path
) -> subprocess.CompletedProcess[str]:
    """The truth is used for the picture and the report only; the search does not get it."""
    dems = [word for path in dem_paths for word in ("--dem", str(path))]
    command = [find_command("localizer"), "locate", str(bundle), *dems, "--json"]
    return subprocess.run(
        [*command, "--plot", str(picture), "--truth", str(truth_path)],
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )


def judge(fix: Fix, truth: dict[str, Any]) -> Outcome:
    """Compare a fix with the truth, in metres of the ground."""
    if fix.position is None or fix.covariance_m2 is None:
        return Outcome(fix, None, None)
    here = fix.position.easting_northing_m
    there = Truth.model_validate(truth).within(fix.position.crs)
    off_m = ground_offset_m(fix.position.crs, here, there)
    sigmas = float(np.sqrt(off_m @ np.linalg.solve(np.array(fix.covariance_m2), off_m)))
    return Outcome(fix, float(np.hypot(*off_m)), sigmas)


def summary(outcome: Outcome, truth: dict[str, Any]) -> str:
    """The result as text."""
    fix = outcome.fix
    lines = [f"status      {fix.status}, probability {fix.probability:.3f}"]
    if fix.position is not None:
        place = fix.position
        lines.append(f"position    {place.lat_deg:.6f}, {place.lon_deg:.6f}, ground {place.ground_m:.1f} m")
    lines.append(
        f"truth       {truth['lat_deg']:.6f}, {truth['lon_deg']:.6f}, ground {truth['ground_m']:.1f} m"
    )
    if outcome.claimed is not None:
        claimed = outcome.claimed
        lines.append(
            f"claimed     1 sigma {claimed.major_m:.1f} m x {claimed.minor_m:.1f} m, the longer towards "
            f"{claimed.azimuth_deg:.0f}° true; 95 % within {claimed.within_95_m:.1f} m"
        )
    if outcome.error_m is not None:
        verdict = (
            "WRONG: outside what the fix claims" if outcome.wrong else f"{outcome.error_sigmas:.1f} sigma"
        )
        lines.append(f"true error  {outcome.error_m:.1f} m ({verdict})")
    times = dict(fix.timing_s)
    preparing_s = times.pop("prepare", 0.0)
    parts = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in times.items())
    lines.append(
        f"search      {sum(times.values()):.2f} s ({parts}), kernels and terrain before it {preparing_s:.2f} s"
    )
    return "\n".join(lines)


def _fields(outcome: Outcome, truth: dict[str, Any], bundle: Path, picture: Path) -> dict[str, Any]:
    return {
        "bundle": str(bundle),
        "fix": json.loads(outcome.fix.to_json()),
        "truth": truth,
        "claimed": None if outcome.claimed is None else outcome.claimed._asdict(),
        "error_m": outcome.error_m,
        "error_sigmas": outcome.error_sigmas,
        "wrong": outcome.wrong,
        "picture": str(picture),
    }


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
