"""What a plain installation lacks: imports against pyproject.toml, and what is said where an extra is missing."""

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scene_attack.errors import InvalidRequest
from scene_attack.extras import MODULES, MissingExtra, extra
from tests.packages import FOLDERS

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LAZY = {
    "services/scene_attack/analysis/campaign_figure.py": "export",
    "services/scene_attack/export/report.py": "export",
    "services/scene_attack/targets/custom/onnx_file.py": "onnx",
    "services/scene_attack_service/jobs/answer_limit.py": "postgresql",
}
"""Modules that are imported only inside a block of `extra`, and so may begin with the imports of one."""
ELSEWHERE = {"stock", "cycles.py", "scene_to_gltf.py"}
"""Files and folders of programs that run elsewhere, the latter in Blender's process (`scene_attack_blender.plugin`)."""
BROUGHT = {
    "OpenEXR": "Imath",
    "pydantic_core": "pydantic",
    "drjit": "mitsuba",
    "google": "onnx",
    "markupsafe": "jinja2",
    "starlette": "fastapi",
}
"""Modules that come with another module's package, or with one that it always brings."""


def names(requirements: list[str]) -> set[str]:
    return {canonicalize_name(Requirement(text).name) for text in requirements} - {"scene-attack"}


BASE = names(PROJECT["dependencies"])
EXTRAS = {name: names(needs) for name, needs in PROJECT["optional-dependencies"].items()}
EXTRAS["service"] |= EXTRAS["export"] | EXTRAS["formats"]


PACKAGES = packages_distributions()


def packages_of(module: str) -> set[str]:
    """The packages that a module may come from."""
    return {canonicalize_name(name) for name in PACKAGES.get(BROUGHT.get(module, module), [])}


def imports(tree: ast.AST, inside: bool = False) -> Iterator[tuple[str, bool]]:
    """Each third-party module that a file imports, and whether a function imports it. Types are no imports."""
    for node in ast.iter_child_nodes(tree):
        found = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found = [node.module]
        for name in (one.partition(".")[0] for one in found):
            if name not in sys.stdlib_module_names and not name.startswith("scene_attack"):
                yield name, inside
        if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
            yield from imports(node, inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def found_in(*roots: str) -> list[tuple[str, str, bool]]:
    files = sorted(path for root in roots for path in (ROOT / root).rglob("*.py"))
    return [
        (str(path.relative_to(ROOT)), module, inside)
        for path in files
        if not ELSEWHERE & {*path.parts}
        for module, inside in imports(ast.parse(path.read_text("utf-8")))
    ]


SERVED = ("scene_attack_service", "scene_attack_api", "scene_attack_worker")
LIBRARY = found_in(*(str(path) for name, path in FOLDERS.items() if name not in SERVED))
SERVICE = found_in(*(str(FOLDERS[name]) for name in SERVED))


def test_a_plain_installation_is_sixteen_packages_and_each_is_imported() -> None:
    assert len(BASE) <= 16
    assert all(BASE & packages_of(module) or inside or file in LAZY for file, module, inside in LIBRARY)
    assert {name for _, module, _ in LIBRARY for name in packages_of(module)} >= BASE


def test_what_the_library_imports_late_is_of_the_extra_that_is_named() -> None:
    for file, module, inside in LIBRARY:
        if not BASE & packages_of(module):
            text = (ROOT / file).read_text("utf-8")
            named = {LAZY[file]} if not inside else set(re.findall(r"extra\(\s*\"(\w+)\"", text))
            assert any(packages_of(module) & EXTRAS[name] or module == "fsspec" for name in named), (file, module)
            assert any(module in MODULES[name] for name in named), (file, module)


def test_what_the_service_imports_is_of_its_extra() -> None:
    for file, module, _ in SERVICE:
        needs = BASE | EXTRAS[LAZY.get(file, "service")]
        assert needs & packages_of(module), (file, module)
        if not BASE & packages_of(module):
            assert module in MODULES[LAZY.get(file, "service")], (file, module)


def test_any_other_missing_module_stays_an_error() -> None:
    with pytest.raises(ModuleNotFoundError), extra("formats", "a mesh"):
        import scene_attack.no_such_module  # noqa: F401
    with (
        pytest.raises(
            MissingExtra, match=r'^file: a mesh needs the extra "formats": pip install "scene-attack\[formats\]"$'
        ),
        extra("formats", "a mesh", "file"),
    ):
        raise ModuleNotFoundError("no lxml", name="lxml.etree")
    assert issubclass(MissingExtra, InvalidRequest)


WITHOUT = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in MODULES:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
MODULES = {modules!r}
import torch, pyrender  # they bring some of these themselves, and import them
for name in [name for name in sys.modules if name.partition(".")[0] in MODULES]:
    del sys.modules[name]
sys.meta_path.insert(0, Missing())
"""


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Runs Python without any package of an extra."""
    modules = sorted({module for listed in MODULES.values() for module in listed})
    program = WITHOUT.format(modules=modules) + code
    return subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=False)


def command(*words: str) -> str:
    return f"sys.argv = {['scene-attack', *words]!r}\nfrom scene_attack.__main__ import main\nmain()"


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [["serve"], ["api"], ["worker"], ["demo", "--once"], ["keys", "list"], ["keys", "create", "a"], ["backup", "copy"]],
    ids=" ".join,
)
def test_a_command_of_the_service_says_which_extra_it_needs(words: list[str], tmp_path: Path) -> None:
    done = run(command(*words), tmp_path)
    assert done.stderr == (
        f'scene-attack: scene-attack {words[0]} needs the extra "service": pip install "scene-attack[service]"\n'
    )
    assert done.returncode == 2


@pytest.mark.slow
def test_all_commands_are_listed(tmp_path: Path) -> None:
    done = run(command("--help"), tmp_path)
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in ("serve", "demo", "keys", "backup", "accuracy", "run", "export"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            "from scene_attack.scenes.reading.formats import read_mesh\nread_mesh(b'<COLLADA/>', 'dae', 9)",
            'file: a dae mesh needs the extra "formats"',
        ),
        (
            "from scene_attack.scenes.reading.formats import read_mesh\nread_mesh(b'PK', '3mf', 9)",
            'file: a 3mf mesh needs the extra "formats"',
        ),
        (
            "from scene_attack.scenes.environment import read_map\nread_map(b'', 'exr')",
            'file: an OpenEXR image (.exr) needs the extra "formats"',
        ),
        (
            "from scene_attack.export.parameters import openexr\nopenexr()",
            'result: the export of a scene that a map lights needs the extra "export"',
        ),
        (
            "from scene_attack.blobs import blobs\nblobs('s3://bucket/folder', 'assets')",
            'a store at s3:// needs the extra "s3"',
        ),
        ("from scene_attack.client.client import Rows\nRows().to_frame()", 'a DataFrame needs the extra "pandas"'),
        (
            "from pathlib import Path\nfrom types import SimpleNamespace as N\n"
            "from scene_attack.targets.custom.loading import _network\n"
            "_network(Path('a.onnx'), N(preprocessing=N(input_size=(8, 8))), 2)",
            'target.name: a network in an .onnx file needs the extra "onnx"',
        ),
    ],
    ids=["collada", "3mf", "exr", "export", "s3", "pandas", "onnx"],
)
def test_a_reader_or_writer_says_which_extra_it_needs(code: str, message: str, tmp_path: Path) -> None:
    done = run(code, tmp_path)
    assert message in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_a_mesh_and_a_map_are_read_in_their_process_without_the_extras(tmp_path: Path) -> None:
    done = run(
        "from scene_attack.scenes.reading import process\nprocess._warm_up()\n"
        "print(process.read({'mesh': 'ply', 'max_faces': 12, 'files': [], 'up': None},"
        " process.exported(process.trimesh.creation.box(), 'ply'))[0])",
        tmp_path,
    )
    assert done.stdout.strip() == "{}", done.stderr
