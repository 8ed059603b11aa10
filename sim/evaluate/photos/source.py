"""Reads the data folder; a missing or broken file ends the evaluation with one line."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.documents import json_file
from sim.errors import SimulationError

Image = NDArray[np.uint8]


def existing(path: Path) -> Path:
    """The path, if it exists. Raises SimulationError."""
    if not path.exists():
        raise SimulationError(
            f"{path}: not there; give the data folder that holds photos, rendered, terrain, local-only"
        )
    return path


def read_json(path: Path) -> Any:
    """Content of a JSON file. Raises SimulationError."""
    return json_file("data", existing(path))


def read_image(path: Path) -> Image:
    """A picture (height, width, 3), BGR, as the sensor had it. Raises SimulationError."""
    existing(path)
    image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise SimulationError(f"{path}: no picture that can be read")
    return np.asarray(image, np.uint8)
