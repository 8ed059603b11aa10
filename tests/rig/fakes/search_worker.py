"""A search process that does as the bundle's name says: ``crash``, ``hang``, ``hog``, ``bad`` or find nothing.

``once-`` before the name: only at the first try, which leaves a file beside the bundle.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

TRACK = {
    "schema": "skyfix.track/1",
    "mode": "whole DEM",
    "hypotheses": [],
    "elsewhere": 1.0,
}
NO_FIX = {
    "schema": "skyfix.fix/1",
    "status": "none",
    "position": None,
    "covariance_m2": None,
    "probability": 0.0,
    "candidates": [],
    "stage1": {"cells": 1, "after_altitude": 0, "after": {}, "points_explored": 0},
    "residual": {},
    "nuisance": None,
    "timing_s": {},
}
CAPTURE_INFO = {
    "utc": "2026-11-26T06:00:00+00:00",
    "monotonic_s": None,
    "heading_deg": None,
    "mounting_sigmas_deg": [0.0, 0.0],
}


def main() -> None:
    dem = json.loads(sys.stdin.readline())["dem"]
    if dem == ["bad.tif"]:
        say({"error": "bad.tif: does not exist"})
        return
    say({"terrain": {"cells": 1}})
    if dem == ["fatal.tif"]:
        return
    say({"pictures": True})
    say({"ready": True})
    hoard = []
    for line in sys.stdin:
        request = json.loads(line)
        bundle = Path(request["bundle"])
        wish, tried = bundle.name, bundle.with_name(f".{bundle.name}.tried")
        if wish.startswith("once-"):
            wish = "fine" if tried.exists() else wish.removeprefix("once-")
            tried.touch()
        match wish:
            case "crash":
                os.kill(os.getpid(), signal.SIGSEGV)
            case "hang":
                time.sleep(1000.0)
            case "hog":
                while True:
                    hoard.append(b"x" * 10_000_000)
                    time.sleep(0.01)
            case "bad":
                say({"error": f"{bundle}: holds no bundle.json"})
                continue
        fix = {**NO_FIX, "bundle": bundle.name}
        say(
            {
                "track": {**TRACK, "bundle": bundle.name, "fix": fix},
                "tracker": {**request["tracker"], "look_evidence": request["tracker"]["look_evidence"] + 1.0},
                "altitude_m": None,
                "azimuth_bias_sigma_deg": None,
                "capture_info": CAPTURE_INFO,
            }
        )


def say(message: dict[str, object]) -> None:
    print(json.dumps(message), flush=True)


if __name__ == "__main__":
    main()
