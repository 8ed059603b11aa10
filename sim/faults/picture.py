"""Faults of a camera's pictures."""

import threading
import time
from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.faults.script import Fault

Picture = NDArray[np.uint8]


class FaultyPictures:
    """Receives each picture and returns the one to send; None to send none."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._active: dict[str, Fault] = {}
        self._held: Picture | None = None
        self._past: deque[tuple[float, Picture]] = deque()

    def begin(self, fault: Fault) -> None:
        """Start ``fault`` with the next picture."""
        with self._lock:
            self._active[fault.fault] = fault
            self._held = None

    def end(self, fault: Fault) -> None:
        """End ``fault``."""
        with self._lock:
            del self._active[fault.fault]

    def __call__(self, picture: Picture) -> Picture | None:
        """The picture sent in place of this one, taken now."""
        with self._lock:
            active = dict(self._active)
            if "stalled" in active:
                return None
            if "frozen" in active:
                self._held = picture if self._held is None else self._held
                picture = self._held
            if "stale" in active:
                picture = self._delayed(picture, active["stale"].parameters["seconds"])
        if "black" in active:
            picture = np.zeros_like(picture)
        for name in ("over-exposed", "burnt-out"):
            if name in active:
                bright = picture.astype(np.float32) * active[name].parameters["gain"]
                picture = np.clip(bright, 0.0, 255.0).astype(np.uint8)
        if "blurred" in active:
            sigma_px = active["blurred"].parameters["sigma_px"]
            picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px), np.uint8)
        if "resolution" in active:
            size = active["resolution"].parameters
            wanted = int(size["width_px"]), int(size["height_px"])
            picture = np.asarray(cv2.resize(picture, wanted), np.uint8)
        return picture

    def _delayed(self, picture: Picture, seconds: float) -> Picture:
        now_s = time.monotonic()
        self._past.append((now_s, picture))
        while len(self._past) > 1 and self._past[1][0] <= now_s - seconds:
            self._past.popleft()
        return self._past[0][1]
