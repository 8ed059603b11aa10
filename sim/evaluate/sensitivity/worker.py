"""Locates cases with a copy of the localizer: ``python -m sim.evaluate.sensitivity.worker JOBS``.

Reads lines ``{"folder": ..., "setting": ...}`` from standard input and writes the rows of all cases, a JSON array, on a line
of standard output for each. Each is done in a forked process, which imports the localizer from the folder: this process has
imported third-party packages only, so that they are loaded once.
"""

import json
import os
import sys
import time
from pathlib import Path
from typing import Any


def main() -> None:
    """Serve until standard input ends. ``JOBS``: JSON of the DEM, the seed and the cases."""
    _import_third_party()
    jobs = json.loads(sys.argv[1])
    for line in sys.stdin:
        request = json.loads(line)
        answer = _in_a_fork(jobs, Path(request["folder"]), request["setting"])
        sys.stdout.write(answer + "\n")
        sys.stdout.flush()


def _import_third_party() -> None:
    import affine  # noqa: F401
    import cv2  # noqa: F401
    import numba  # noqa: F401
    import pydantic  # noqa: F401
    import pyproj  # noqa: F401
    import rasterio  # noqa: F401
    import scipy.signal
    import scipy.spatial
    import scipy.stats  # noqa: F401


def _in_a_fork(jobs: dict[str, Any], folder: Path, setting: str) -> str:
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        status = 1
        try:
            with os.fdopen(writing, "w", encoding="utf-8") as out:
                out.write(json.dumps(_rows(jobs, folder, setting)))
            status = 0
        finally:
            os._exit(status)
    os.close(writing)
    with os.fdopen(reading, encoding="utf-8") as answer:
        text = answer.read()
    _, status = os.waitpid(child, 0)
    return text if status == 0 else json.dumps(None)


def _rows(jobs: dict[str, Any], folder: Path, setting: str) -> list[dict[str, Any]]:
    assert "localizer" not in sys.modules
    sys.path.insert(0, str(folder))
    import localizer

    assert Path(localizer.__file__).is_relative_to(folder)
    from sim.evaluate.case import Experiment, run_case
    from sim.evaluate.scenario import load_evaluation_scenario

    rows = []
    for scenario_path, case in jobs[setting]:
        experiment = Experiment(
            (Path(jobs["dem"]),),
            load_evaluation_scenario(Path(scenario_path)),
            jobs["seed"],
            estimator_only=setting == "exact DEM",
        )
        begin_s = time.process_time()
        row = run_case(experiment, case)
        rows.append(
            row.model_dump() | {"scenario": Path(scenario_path).stem, "cpu_s": time.process_time() - begin_s}
        )
    return rows


if __name__ == "__main__":
    main()
