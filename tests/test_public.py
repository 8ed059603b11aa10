"""The public Python API: of all packages light to import and whole; of ``rig`` and ``sim`` its style, and its examples run."""

import ast
import doctest
import inspect
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from doc_examples import examples_of, require_what_it_says
from fakes.example_devices import example_names

import localizer
import rig
import sim

ALL = {"localizer": localizer, "rig": rig, "sim": sim}
PACKAGES = {"rig": rig, "sim": sim}
NAMES = [(package, name) for package in PACKAGES for name in PACKAGES[package].__all__]
SLOW = {"numpy", "scipy", "numba", "cv2", "pydantic", "rasterio", "pyproj", "matplotlib", "click", "fastapi"}
WITHOUT_EXAMPLE = {"BundleAltitude", "BundleCamera"}  # localizer's; shown in write_bundle's


def exported(package: str, name: str) -> Any:
    return getattr(PACKAGES[package], name)


@pytest.mark.parametrize(
    "module", [*ALL, "localizer.errors", "rig.errors", "sim.errors", "sim.pytest_plugin"]
)
def test_importing_it_loads_nothing_slow(module: str) -> None:
    code = f"import json, sys; before = list(sys.modules); import {module}; print(json.dumps([before, list(sys.modules)]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before, after = (set(names) for names in json.loads(done.stdout))
    assert module in after
    assert not SLOW & {name.split(".")[0] for name in after}
    if module in ALL:
        assert not {name for name in after if name.startswith(f"{module}.")}
        assert "importlib.metadata" not in after - before  # the start of an editable install may import it


@pytest.mark.parametrize(
    ("package", "name"), [(package, name) for package in ALL for name in ALL[package].__all__]
)
def test_each_name_resolves_and_none_is_a_module(package: str, name: str) -> None:
    thing = getattr(ALL[package], name)
    assert thing is not None
    assert not isinstance(thing, ModuleType)
    folder = Path(str(ALL[package].__file__)).parent
    assert not (folder / name).exists()
    assert not (folder / f"{name}.py").exists()


@pytest.mark.parametrize("package", ALL)
def test_the_stub_and_the_package_export_the_same(package: str) -> None:
    """``__all__`` of the stub is what type checkers see, the imports in it are what there is."""
    tree = ast.parse(Path(str(ALL[package].__file__)).with_suffix(".pyi").read_text(encoding="utf-8"))
    (named,) = (ast.literal_eval(node.value) for node in tree.body if isinstance(node, ast.Assign))
    assert sorted(named) == sorted(ALL[package].__all__)
    assert set(ALL[package].__all__) <= set(dir(ALL[package]))


def test_versions() -> None:
    from importlib.metadata import version

    assert localizer.__version__ == rig.__version__ == sim.__version__ == version("skyfix")


def sections(text: str) -> list[str]:
    """The headings of a numpydoc docstring, in order."""
    return [
        line.strip()
        for line, below in itertools.pairwise(text.splitlines())
        if below.strip() and set(below.strip()) == {"-"} and len(below.strip()) == len(line.strip())
    ]


ORDER = ["Parameters", "Attributes", "Returns", "Yields", "Raises", "Notes", "Examples"]


@pytest.mark.parametrize(("package", "name"), NAMES)
def test_docstrings_are_in_the_style_of_numpydoc(package: str, name: str) -> None:
    thing = exported(package, name)
    if not (inspect.isfunction(thing) or inspect.isclass(thing)) or name in WITHOUT_EXAMPLE:
        return
    text = inspect.getdoc(thing)
    assert text
    assert text.splitlines()[0].endswith((".", ":"))
    found = sections(text)
    assert found == [heading for heading in ORDER if heading in found]
    if inspect.isfunction(thing):
        wanted = {"Examples", "Parameters"}
        assert wanted <= set(found)
        assert {"Returns", "Yields"} & set(found)
        for parameter in inspect.signature(thing).parameters:
            assert parameter in text
    elif not issubclass(thing, Exception) and "." not in name:
        assert {"Parameters", "Attributes", "Examples"} & set(found), name


METHODS = [
    (f"{package}.{name}.{called}", method)
    for package, name in NAMES
    if inspect.isclass(exported(package, name)) and not issubclass(exported(package, name), Exception)
    for called, method in inspect.getmembers(exported(package, name), inspect.isroutine)
    if not called.startswith("_") and getattr(method, "__module__", "").split(".")[0] in PACKAGES
]


@pytest.mark.parametrize(("name", "method"), METHODS, ids=[name for name, _ in METHODS])
def test_methods_say_what_their_parameters_are(name: str, method: Any) -> None:
    text = inspect.getdoc(method)
    assert text
    found = sections(text)
    assert found == [heading for heading in ORDER if heading in found]
    parameters = [each for each in inspect.signature(method).parameters if each not in ("self", "cls")]
    assert not parameters or "Parameters" in found, name
    for parameter in parameters:
        assert parameter in text.partition("Parameters")[2]


def with_examples() -> Iterator[Any]:
    """Every docstring of the public API that has an example: the packages', those of names, those of public methods."""
    for package, module in PACKAGES.items():
        things: dict[str, Any] = {package: module}
        for name in module.__all__:
            thing = exported(package, name)
            things[f"{package}.{name}"] = thing
            if inspect.isclass(thing):
                methods = inspect.getmembers(thing, inspect.isroutine)
                things |= {f"{package}.{name}.{m}": method for m, method in methods if not m.startswith("_")}
        yield from examples_of(
            {
                name: thing
                for name, thing in things.items()
                if inspect.ismodule(thing) or inspect.isfunction(thing) or inspect.isclass(thing)
            }
        )


EXAMPLES = list(with_examples())


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    with example_names(tmp_path_factory.mktemp("examples")) as found:
        yield found


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_an_example_shows_what_it_says(
    example: doctest.DocTest, names: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    require_what_it_says(example, names)


def test_every_public_function_has_an_example() -> None:
    shown = {example.name for example in EXAMPLES}
    functions = {
        f"{package}.{name}" for package, name in NAMES if inspect.isfunction(exported(package, name))
    }
    assert functions <= shown
    assert {"rig", "sim"} <= shown


def test_a_driver_is_closed_when_its_block_ends(names: dict[str, Any]) -> None:
    with rig.open_chip(rig.Adxl355, names["i2c_bus"], 0x1D) as chip:
        assert chip.read().z_g == pytest.approx(1.0, abs=0.01)
    with pytest.raises(rig.DeviceError):
        chip.read()


def test_what_went_wrong_in_a_block_is_not_hidden_by_what_goes_wrong_when_it_is_closed(
    names: dict[str, Any],
) -> None:
    chip = rig.open_chip(rig.Adxl355, names["i2c_bus"], 0x1D)
    chip.close()  # so that closing it again fails

    def broken_block() -> None:
        with chip:
            raise KeyError("mine")

    with pytest.raises(rig.DeviceError):
        chip.close()
    with pytest.raises(KeyError, match="mine"):
        broken_block()


def test_a_type_checker_knows_the_exported_types(tmp_path: Path) -> None:
    for package in ALL.values():
        assert (Path(str(package.__file__)).parent / "py.typed").is_file()


@pytest.fixture
def simulated_world() -> sim.World:
    """Another world than the plugin's, as the tests of another program would ask for."""
    from fakes.simulated import world

    return world()


def test_the_fixture_runs_a_rig_in_the_world_that_is_asked_for(
    simulated_rig: sim.SimulatedRig, simulated_world: sim.World
) -> None:
    config = rig.load_config(simulated_rig.config_path)
    with rig.open_chip(rig.Adxl355, config.inclinometer.bus, config.inclinometer.address) as chip:
        assert chip.read().temperature_c == pytest.approx(simulated_world.air_temperature_c, abs=5.0)
    assert simulated_rig.environment["SKYFIX_CONFIG"] == str(simulated_rig.config_path)
    assert simulated_rig.truth()["lat_deg"] == simulated_world.place.lat_deg
    assert os.environ.get("SKYFIX_CONFIG") != str(simulated_rig.config_path)
