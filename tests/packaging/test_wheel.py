"""What a user has who installs the wheel: every file, the three commands from any folder, the fixture for tests, the types.

It is built from a copy of the sources and installed into an environment of its own, which finds the dependencies where these
tests have them: nothing is downloaded.
"""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]

ROOT = Path(__file__).parents[2]
PACKAGES = ("localizer", "rig", "sim")
SOURCES = (*PACKAGES, "configs", "systemd", "pyproject.toml", "README.md", "LICENSE")
MADE_WHEN_RUN = shutil.ignore_patterns("__pycache__", "*.egg-info")


def files_of(package: str) -> Iterator[str]:
    """All files of a package in the sources, those behind links too, as a wheel names them."""
    for folder, _, names in os.walk(ROOT / package, followlinks=True):
        if "__pycache__" not in Path(folder).parts:
            yield from (str(Path(folder, name).relative_to(ROOT)) for name in names)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built as ``pip install`` builds it, without an environment of its own for setuptools."""
    sources, out = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("dist")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, sources / name, symlinks=True, ignore=MADE_WHEN_RUN)
        else:
            shutil.copy(ROOT / name, sources)
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--wheel-dir", out, sources], check=True)
    (built,) = out.glob("skyfix-*.whl")
    return built


class Installed:
    """An environment that holds the wheel, and the folder that its commands are run in."""

    def __init__(self, environment: Path, folder: Path) -> None:
        self.python = environment / "bin" / "python"
        self.folder = folder
        self._path = os.pathsep.join([str(self.python.parent), os.environ["PATH"]])

    def run(self, *words: str | Path, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
        """Run a command, found in the environment first."""
        variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        return subprocess.run(
            [str(word) for word in words],
            env={**variables, "PATH": self._path},
            cwd=folder or self.folder,
            capture_output=True,
            text=True,
            check=False,
        )

    def says(self, code: str) -> str:
        """What a Python program in the environment prints."""
        done = self.run(self.python, "-c", code)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    environment = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
    python = environment / "bin" / "python"
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        wheel,
    ]
    subprocess.run(pip, check=True)
    (libraries,) = environment.glob("lib/python*/site-packages")
    # The folder alone: what makes these tests find the sources does not come with it.
    (libraries / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    return Installed(environment, tmp_path_factory.mktemp("elsewhere"))


def test_every_file_of_the_packages_is_in_the_wheel(wheel: Path) -> None:
    packed = set(zipfile.ZipFile(wheel).namelist())
    wanted = {name for package in PACKAGES for name in files_of(package)}
    assert len(wanted) > 400
    assert {"sim/scenarios/uncalibrated.toml", "rig/service/units/skyfix.service", "rig/py.typed"} <= wanted
    assert wanted <= packed
    beside = {name for name in packed - wanted if ".dist-info/" not in name}
    assert not beside


def test_the_licence_is_in_the_wheel(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    (licence,) = (name for name in archive.namelist() if name.endswith(".dist-info/licenses/LICENSE"))
    assert archive.read(licence) == (ROOT / "LICENSE").read_bytes()


@pytest.mark.parametrize("package", PACKAGES)
def test_it_is_the_wheel_that_is_tried(installed: Installed, package: str) -> None:
    found = Path(installed.says(f"import {package}; print({package}.__file__)"))
    assert installed.python.parents[1] in found.parents


@pytest.mark.parametrize("program", PACKAGES)
def test_the_commands_are_installed(installed: Installed, program: str) -> None:
    said = installed.run(program, "--version")
    assert said.stdout == f"{program} {installed.says('import rig; print(rig.__version__)')}\n", said.stderr


def test_the_demo_runs_from_any_folder_and_its_fix_is_shown(installed: Installed) -> None:
    done = installed.run("sim", "demo", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["fix"]["status"] == "fix"
    assert found["error_m"] < 30.0
    assert (installed.folder / found["picture"]).stat().st_size > 10_000
    dem = installed.says("import sim; print(sim.EMBEDDED_DEM)")
    shown = installed.run("localizer", "locate", found["bundle"], "--dem", dem, "--report", "report")
    assert shown.returncode == 0, shown.stderr
    assert "<html" in (installed.folder / "report" / "report.html").read_text(encoding="utf-8")


def test_the_rigs_fresh_from_the_workshop_find_their_scenario(installed: Installed) -> None:
    """It is read before the DEM, which is not there."""
    done = installed.run("sim", "rigs", "--rigs", "1", "--dem", "absent.tif", "--json")
    (refused,) = json.loads(done.stdout)["rigs"]
    assert "absent.tif" in refused["refused"]
    assert installed.run("sim", "run", "--scenario", "ideal", "--", "rig", "--version").stdout.startswith(
        "rig "
    )


def test_the_service_and_its_page_find_their_files(installed: Installed) -> None:
    done = installed.run("rig", "service", "status", "--root", installed.folder / "machine", "--json")
    assert set(json.loads(done.stdout)["files"].values()) == {"absent"}, done.stderr
    assert (
        installed.says("from rig.daemon.http.app import PAGE; print((PAGE / 'index.html').is_file())")
        == "True"
    )
    no_configuration = installed.run("rig", "check").stderr
    example = Path(no_configuration.partition("(example: ")[2].rstrip().rstrip(")"))
    assert example.read_bytes() == (ROOT / "configs" / "vehicle.toml").read_bytes()


def test_the_fixture_is_there_for_the_tests_of_others(installed: Installed, tmp_path: Path) -> None:
    (tmp_path / "test_theirs.py").write_text(
        "import subprocess\n"
        "def test_their_program(simulated_rig):\n"
        "    done = subprocess.run(['rig', 'move', '--park', '--json'], env={**__import__('os').environ, "
        "**simulated_rig.environment}, check=False)\n"
        "    assert done.returncode == 0\n",
        encoding="utf-8",
    )
    done = installed.run(
        installed.python, "-m", "pytest", "-q", "-p", "no:cacheprovider", tmp_path, folder=tmp_path
    )
    assert "1 passed" in done.stdout, done.stdout + done.stderr


def test_a_type_checker_sees_the_types_of_the_public_api(installed: Installed, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(
        "import rig, sim\n"
        "with rig.open_chip(rig.Adxl355, '/dev/i2c-1', 0x1D) as chip:\n"
        "    x_g: float = chip.read().x_g\n"
        "wrong: str = sim.World.create(seed=3).place.lat_deg\n",
        encoding="utf-8",
    )
    mypy = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--follow-imports=silent",
        "--cache-dir",
        tmp_path / "cache",
    ]
    done = installed.run(*mypy, "--python-executable", installed.python, program, folder=tmp_path)
    lines = done.stdout.splitlines()
    assert [line for line in lines if "error" in line][:1] == [
        f'{program.name}:4: error: Incompatible types in assignment (expression has type "float", variable has '
        'type "str")  [assignment]'
    ], done.stdout + done.stderr
    assert lines[-1].startswith("Found 1 error")
