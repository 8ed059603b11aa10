"""Summary of a series: number of bundles, failures, spread of the readings, duration."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rig.attitude.heading import circular_mean_deg
from rig.attitude.kinematics import wrapped_deg
from rig.capture.averaged_readings import utc_text
from rig.series.journal import Series

ROUND = ("heading_deg", "azimuth_deg")  # angles without a beginning


def summary(series: Series) -> dict[str, Any]:
    """The summary as JSON values; spreads are standard deviations, None for a single bundle."""
    outcomes = [series.outcomes[number] for number in sorted(series.outcomes)]
    taken = [outcome for outcome in outcomes if outcome.bundle]
    failed = [outcome for outcome in outcomes if outcome.reason]
    return {
        "series": series.id,
        "directory": str(series.folder),
        "repeat": series.plan.repeat,
        "taken": len(taken),
        "failed": len(failed),
        "left": len(series.remaining()),
        "failures": [
            {"number": outcome.number, "time": utc_text(outcome.time), "reason": outcome.reason}
            for outcome in failed
        ],
        "begun": utc_text(min(series.begun.values())) if series.begun else None,
        "last": utc_text(max(outcome.time for outcome in outcomes)) if outcomes else None,
        "took_s": _three([outcome.took_s for outcome in taken if outcome.took_s is not None]),
        "readings": {
            name: _spread(name, values)
            for name, values in _by_name([each.readings for each in taken]).items()
        },
    }


def summary_text(found: Mapping[str, Any]) -> str:
    """The summary as text."""
    remaining = f", {found['left']} left: the same command goes on with them" if found["left"] else ""
    lines = [
        f"{found['series']}: {found['taken']} of {found['repeat']} bundles taken, {found['failed']} failed{remaining}"
    ]
    lines += [f"  failed  {f['number']} at {f['time']}: {f['reason']}" for f in found["failures"]]
    if found["took_s"]:
        times = found["took_s"]
        lines.append(
            f"  took    {times['median']:.1f} s each ({times['least']:.1f} to {times['most']:.1f}); "
            f"{found['begun']} to {found['last']}"
        )
    for name, values in found["readings"].items():
        what, _, unit = name.rpartition("_")
        if unit == "share":
            what, unit = name.replace("_", " "), ""
        line = f"  {what:<22} {values['mean']:9.3f} {unit:<4}"
        if values["spread"] is not None:
            line += f"  spread {values['spread']:.3f} ({values['least']:.3f} to {values['most']:.3f})"
        lines.append(line.rstrip())
    return "\n".join(lines)


def _by_name(readings: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """Values of all bundles by name, without sigmas."""
    names = dict.fromkeys(name for each in readings for name in each if not name.endswith("sigma_deg"))
    names.pop("altitude_sigma_m", None)
    return {name: [each[name] for each in readings if name in each] for name in names}


def _spread(name: str, values: Sequence[float]) -> dict[str, float | None]:
    found = np.array(values)
    if name.endswith(ROUND):
        middle = circular_mean_deg(found)
        found = middle + np.array([wrapped_deg(value - middle) for value in values])
    return {
        "mean": round(float(found.mean()), 4),
        "spread": round(float(found.std(ddof=1)), 4) if len(found) > 1 else None,
        "least": round(float(found.min()), 4),
        "most": round(float(found.max()), 4),
    }


def _three(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    return {"least": min(values), "median": float(np.median(values)), "most": max(values)}
