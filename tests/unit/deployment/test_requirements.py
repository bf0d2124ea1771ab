"""pyproject.toml against the requirements files: names, bounds and pins cannot drift apart."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from tests.packages import FOLDERS

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]
WHEEL = PYPROJECT["tool"]["scikit-build"]["wheel"]["packages"]
BUILD = PYPROJECT["build-system"]["requires"]
EXTRAS = PROJECT["optional-dependencies"]
DEVELOPMENT = ("dev", "bench", "maite", "mitsuba", "pandas")
"""Extras that the tests or the benchmarks need and the product's image does not."""
DIRECT = {
    "requirements.txt": PROJECT["dependencies"]
    + [
        one
        for extra, needs in EXTRAS.items()
        if extra not in DEVELOPMENT
        for one in needs
        if not one.startswith("scene-attack[")
    ],
    "requirements-dev.txt": EXTRAS["dev"],
    "requirements-renderers.txt": EXTRAS["mitsuba"],
}


def pins(path: str) -> dict[str, Version]:
    """The exact versions in a requirements file for this Python, by canonical name; included files are left out."""
    lines = [line.removesuffix(" \\") for line in (ROOT / path).read_text().splitlines() if line[:1].isalpha()]
    found = [one for one in map(Requirement, lines) if one.marker is None or one.marker.evaluate()]
    assert all(str(one.specifier).startswith("==") for one in found)
    names = [canonicalize_name(one.name) for one in found]
    assert len(names) == len(set(names))
    return {name: Version(str(one.specifier)[2:]) for name, one in zip(names, found, strict=True)}


def pulled_in(direct: list[str]) -> set[str]:
    """These packages and all that they need, by what is installed."""
    found: set[str] = set()
    wanted = [(one.name, extra) for one in map(Requirement, direct) for extra in ("", *one.extras)]
    while wanted:
        name, extra = wanted.pop()
        new = canonicalize_name(name) not in found
        if not new and not extra:
            continue
        found.add(canonicalize_name(name))
        for text in distribution(name).requires or []:
            need = Requirement(text)
            if need.marker is None or need.marker.evaluate({"extra": extra}):
                wanted += [(need.name, one) for one in ("", *need.extras)]
    return found


@pytest.mark.parametrize("path", DIRECT)
def test_each_direct_dependency_has_a_lower_bound_that_its_pin_satisfies(path: str) -> None:
    everything = pins("requirements.txt") | pins("requirements-torch.txt") | pins(path)
    for text in DIRECT[path]:
        need = Requirement(text)
        assert {one.operator for one in need.specifier} in ({">="}, {">=", "<"}), text
        assert everything[canonicalize_name(need.name)] in need.specifier, text


def test_the_runtime_pins_are_what_the_runtime_dependencies_pull_in() -> None:
    # A build of torch for CUDA also needs NVIDIA's libraries and Triton, in versions that it names exactly.
    needed = {
        one for one in pulled_in(DIRECT["requirements.txt"]) if not one.startswith(("cuda-", "nvidia-", "triton"))
    }
    assert set(pins("requirements.txt") | pins("requirements-torch.txt")) == needed


def test_the_build_pins_are_what_builds_the_wheel_and_agree_with_the_others() -> None:
    pinned = pins("requirements-build.txt")
    for text in BUILD:
        assert pinned[canonicalize_name(Requirement(text).name)] in Requirement(text).specifier
    try:
        wanted = pulled_in([*BUILD, "cmake", "ninja"]) - set(pins("requirements.txt"))
    except PackageNotFoundError as missing:
        pytest.fail(f"run scripts/setup: {missing}")
    assert set(pinned) == wanted
    others = pins("requirements-dev.txt")
    assert all(others.get(name, version) == version for name, version in pinned.items())


def test_the_development_pins_are_what_the_extra_pulls_in_beside_them() -> None:
    try:
        wanted = pulled_in(DIRECT["requirements-dev.txt"]) - set(pins("requirements.txt")) - {"torch"}
    except PackageNotFoundError as missing:
        pytest.fail(f"run scripts/setup --test: {missing}")
    assert set(pins("requirements-dev.txt")) == wanted
    assert "-r requirements.txt" in (ROOT / "requirements-dev.txt").read_text().splitlines()


@pytest.mark.parametrize(
    "path",
    [*DIRECT, "requirements-build.txt", "benchmarks/requirements.txt", "tests/integration/client_generator.txt"],
)
def test_each_pin_has_the_hashes_of_its_files(path: str) -> None:
    text = re.sub(r"^(#|-r ).*\n", "", (ROOT / path).read_text(), flags=re.MULTILINE)
    pin = r"[a-z][^\\\n]+==[^\\\n]+"
    hashes = r"( \\\n    --hash=sha256:[0-9a-f]{64})+\n"
    assert re.sub(f"^{pin}{hashes}", "", text, flags=re.MULTILINE) == "", "write them with scripts/write-hashes"


def test_the_extra_for_benchmarks_is_among_their_requirements() -> None:
    pinned = pins("benchmarks/requirements.txt")
    for text in EXTRAS["bench"]:
        need = Requirement(text)
        assert pinned[canonicalize_name(need.name)] in need.specifier, text


@pytest.mark.questions
def test_each_package_says_that_it_is_typed() -> None:
    assert {str(path.relative_to(ROOT)) for path in FOLDERS.values()} == set(WHEEL)
    assert all((package / "py.typed").is_file() for package in FOLDERS.values())


def test_what_the_package_declares_as_its_licence_is_there_also_in_the_image() -> None:
    copied = re.search(r"^COPY pyproject.toml (.+) \./$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    assert copied is not None
    for name in PROJECT["license-files"]:
        assert (ROOT / name).is_file()
        assert name in copied[1].split()
        assert f"!{name}" in (ROOT / ".dockerignore").read_text().splitlines()
