"""Drives the simulated rig as a user does: its odometer sends the motion, its inclinometer vibrates."""

import os
import subprocess

import numpy as np

from sim.launch.child_command import find_command, search_path
from sim.launch.launcher import SimulatedRig

LEG_M = 250.0
MARGIN_CELLS = 100
M_PER_DEG = 111_000.0


def next_stop(rig: SimulatedRig, course_deg: float) -> tuple[float, float, float]:
    """Latitude, longitude and course of a stop one leg away that is well inside the terrain, near the course."""
    here = rig.world.place
    for turn_deg in (0.0, 40.0, -40.0, 80.0, -80.0, 120.0, 180.0):
        course = np.radians(course_deg + turn_deg)
        lat_deg = here.lat_deg + LEG_M * np.cos(course) / M_PER_DEG
        lon_deg = here.lon_deg + LEG_M * np.sin(course) / (M_PER_DEG * np.cos(np.radians(here.lat_deg)))
        row, col = rig.world.surface.terrain.row_col(lon_deg, lat_deg)
        rows, cols = rig.world.surface.height_m.shape
        inside = (
            MARGIN_CELLS < float(row) < rows - MARGIN_CELLS
            and MARGIN_CELLS < float(col) < cols - MARGIN_CELLS
        )
        if inside:
            return float(lat_deg), float(lon_deg), course_deg + turn_deg
    raise AssertionError("nowhere to go")


def drive_to(rig: SimulatedRig, lat_deg: float, lon_deg: float, seconds: float) -> None:
    """``sim drive`` there; returns when the vehicle is stationary."""
    command = [find_command("sim"), "drive", "--seconds", str(seconds), "--"]
    environment = {**os.environ, "PATH": search_path(), **rig.environment}
    subprocess.run([*command, f"{lat_deg:.7f}", f"{lon_deg:.7f}"], env=environment, check=True, timeout=300)
