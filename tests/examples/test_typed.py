"""A program that uses the wheel passes mypy --strict: the stub and the markers are in it, and the types are right."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROGRAM = """
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import localizer
import rig
import sim

dem: localizer.Dem = localizer.load_dem("terrain.tif")
elevation_deg: NDArray[np.float64] = localizer.horizon(dem, 37.25, -122.15, 700.0, np.arange(360.0)).elevation_deg
bundle = localizer.load_bundle(Path("bundles/first"))
result = localizer.locate(bundle, dem)
if result.fix.position is not None:
    lat_deg: float = result.fix.position.lat_deg
    semi_major_m: float = result.fix.error_ellipse(0.95).semi_major_m
step = localizer.Tracker().step(bundle, dem, movement=localizer.Movement(np.zeros(2), np.eye(2)))
hypotheses: tuple[localizer.TrackHypothesis, ...] = step.hypotheses
version: str = localizer.__version__
"""
WRONG = """
import localizer

localizer.load_dem("terrain.tif", units="ft")
localizer.locate("bundle", localizer.load_dem("terrain.tif"))
localizer.settle_frames
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment in which skyfix was installed from its wheel."""
    folder = tmp_path_factory.mktemp("installed")
    source = folder / "source"  # where it is built, so that nothing of an earlier build gets into the wheel
    for package in ("rig", "localizer", "sim"):
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", str(folder), str(source)], check=True)
    (wheel,) = folder.glob("skyfix-*.whl")
    venv.create(folder / "venv", with_pip=False)
    packages = next((folder / "venv").glob("lib/python*/site-packages"))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    (packages / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "venv" / "bin" / "python"


def mypy(python: Path, folder: Path, program: str) -> subprocess.CompletedProcess[str]:
    """mypy --strict on a program that lies outside the repository."""
    file = folder / "program.py"
    file.write_text(program)
    command = [sys.executable, "-m", "mypy", "--strict", "--python-executable", str(python), str(file)]
    environment = {name: value for name, value in os.environ.items() if name != "MYPYPATH"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.long
def test_a_program_that_uses_the_wheel_passes_mypy(python: Path, tmp_path: Path) -> None:
    checked = mypy(python, tmp_path, PROGRAM)
    assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.long
def test_a_wrong_program_does_not(python: Path, tmp_path: Path) -> None:
    said = mypy(python, tmp_path, WRONG).stdout
    assert 'Unexpected keyword argument "units" for "load_dem"' in said
    assert 'Argument 1 to "locate" has incompatible type "str"' in said
    assert 'has no attribute "settle_frames"' in said
