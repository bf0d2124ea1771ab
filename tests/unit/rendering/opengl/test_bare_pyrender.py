"""pyrender is entered without what it never needs off screen, and is whole for who asks for more."""

import subprocess
import sys


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_drawing_imports_no_windows_no_graphs_and_no_mesh_reader() -> None:
    code = (
        "import sys; from services.rendering.opengl import context; context.current();"
        "print({'pyglet', 'networkx', 'trimesh', 'pyrender.viewer', 'pyrender.scene'} & set(sys.modules))"
    )
    assert run(code) == "set()"


def test_the_whole_package_is_there_when_asked_for() -> None:
    code = (
        "from services.rendering.opengl import context; context.current(); import pyrender;"
        "print(pyrender.Scene().ambient_light.tolist(), pyrender.Mesh.__name__, pyrender.__version__)"
    )
    assert run(code).startswith("[0.0, 0.0, 0.0] Mesh 1.")


def test_a_name_it_does_not_have_is_missing_as_ever() -> None:
    code = "from services.rendering.opengl import context; context.current(); "
    code += "import pyrender; print(hasattr(pyrender, 'nonsense'))"
    assert run(code) == "False"
