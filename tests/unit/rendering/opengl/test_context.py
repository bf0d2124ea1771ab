import dataclasses
import json
import os
import sys
import threading

import numpy as np
import pytest
import torch

from scene_attack.errors import JobFailure
from scene_attack.process import replaced
from scene_attack.rendering.opengl import context
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from tests.unit.rendering.shapes import PLATFORMS, mesh, on_platform, placed, quad, scene

pytestmark = pytest.mark.slow


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch, tmp_path):
    """The environment of a process that has not chosen a platform yet, nor any before it."""
    monkeypatch.setattr(context, "_taken", {})
    monkeypatch.setattr(context, "_egl_trouble", "")
    for name in ("PYOPENGL_PLATFORM", "EGL_DEVICE_ID"):
        monkeypatch.setenv(name, "")  # so that what the code under test sets is taken back afterwards
        monkeypatch.delenv(name)
    with replaced(cache=tmp_path, gl="auto"):
        yield monkeypatch


def test_the_backend_names_platform_driver_and_libraries() -> None:
    backend = context.gl_backend()
    assert backend.split()[0] in PLATFORMS
    for word in ("OpenGL", "float32", "pyrender-maintained", "PyOpenGL"):
        assert word in backend
    assert context.current() is context.current()


@pytest.mark.usefixtures("fresh")
def test_auto_takes_egl_where_it_draws() -> None:
    assert context.choose_platform() == "egl"
    assert os.environ["PYOPENGL_PLATFORM"] == "egl"
    assert os.environ["EGL_DEVICE_ID"].isdigit()


def test_auto_falls_back_to_osmesa_where_egl_does_not_draw(fresh: pytest.MonkeyPatch) -> None:
    fresh.setenv("EGL_DEVICE_ID", "99")  # no machine has so many
    assert context.choose_platform() == "osmesa"
    assert os.environ["PYOPENGL_PLATFORM"] == "osmesa"


def test_egl_on_demand_says_what_to_install_where_it_does_not_draw(fresh: pytest.MonkeyPatch) -> None:
    fresh.setenv("EGL_DEVICE_ID", "99")
    with replaced(gl="egl"), pytest.raises(JobFailure, match=r"EGL does not work here .*libegl1 .*libosmesa6"):
        context.choose_platform()


def test_a_platform_that_fails_says_what_to_install() -> None:
    code = "import os; os.environ['EGL_DEVICE_ID'] = '99'\nfrom scene_attack.rendering.opengl import context\n"
    code += "try: context.current()\nexcept Exception as error: print(type(error).__name__, error)"
    answer = on_platform("egl", code)
    assert answer.startswith("JobFailure internal: cannot draw with egl")
    assert "libosmesa6" in answer


def test_where_no_platform_draws_both_reasons_are_said(fresh: pytest.MonkeyPatch) -> None:
    fresh.setenv("EGL_DEVICE_ID", "99")
    fresh.setitem(sys.modules, "pyrender.platforms.osmesa", None)
    with pytest.raises(JobFailure, match=r"cannot draw with osmesa \(.*osmesa.*; with egl: .*device 99.*libosmesa6"):
        context._create(context.choose_platform())  # noqa: SLF001


@pytest.mark.parametrize("platform", PLATFORMS)
def test_no_library_of_a_desktop_is_needed(platform: str) -> None:
    """pyglet, of which pyrender's viewer is made, asked for libXrender; a server without it could draw nothing."""
    code = "import sys; sys.modules['tkinter'] = None\n"  # of which the viewer can do without, and which loads it, too
    code += "from scene_attack.rendering.opengl import context; context.current()\n"
    code += "print(*(path for path in context.loaded() if 'Mesa' in path or 'EGL' in path or 'Xrender' in path))"
    libraries = on_platform(platform, code)
    assert "Mesa" in libraries or "EGL" in libraries
    assert "Xrender" not in libraries


def test_a_platform_already_chosen_is_kept(fresh: pytest.MonkeyPatch) -> None:
    fresh.setenv("PYOPENGL_PLATFORM", "osmesa")
    assert context.choose_platform() == "osmesa"
    with replaced(gl="egl"), pytest.raises(JobFailure, match="contradicts"):
        context.choose_platform()
    fresh.setenv("PYOPENGL_PLATFORM", "glx")
    with pytest.raises(JobFailure, match="use egl or osmesa"):
        context.choose_platform()


def test_another_thread_is_refused() -> None:
    renderer = PyrenderRenderer(placed(scene((8, 8)), mesh(quad(2.0))))
    caught: list[BaseException] = []

    def use() -> None:
        try:
            renderer.render({})
        except JobFailure as error:
            caught.append(error)

    thread = threading.Thread(target=use)
    thread.start()
    thread.join()
    assert "thread" in str(caught[0])


def test_a_forked_process_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(context, "_context", dataclasses.replace(context.current(), pid=os.getpid() + 1))
    with pytest.raises(JobFailure, match="fork"):
        context.current()


def test_a_uniform_that_does_not_exist_is_an_error() -> None:
    program = context.current().renderer.program(
        "radiance.frag", textured=False, holes=False, n_images=1, lights=(1, 0, 0)
    )
    with pytest.raises(KeyError, match=r"radiance\.frag has no uniform 'ambiant'"):
        program.set("ambiant", 0.5)


def test_values_survive_beyond_one_and_below_half_a_step_of_eight_bits() -> None:
    renderer = PyrenderRenderer(placed(scene((8, 8)), mesh(quad(2.0))))
    levels = torch.tensor([1e-6, 1e-3, 50.0])
    ambient = torch.zeros(3, 5)
    ambient[:, 0] = levels
    pixel = renderer.radiance({"illumination": ambient})[:, 4, 4, 0]
    torch.testing.assert_close(pixel / pixel[1], levels / levels[1], rtol=1e-5, atol=0)


_IMAGES = """
import sys
import numpy as np
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from tests.unit.rendering import shapes

scene = shapes.placed(shapes.scene((96, 128), 2, azimuth=0.5, elevation=0.4), shapes.six_parts(),
    shapes.mesh(shapes.sphere(0.4, 48, color=(0.8, 0.5, 0.2, 0.6))))
g = rasterise(scene)
np.savez(sys.argv[1], image=PyrenderRenderer(scene).render({})[0], coverage=g.coverage, normals=g.normals,
    color=g.base_color)
"""


def test_egl_and_osmesa_agree(tmp_path) -> None:
    images = []
    for platform in PLATFORMS:
        on_platform(platform, _IMAGES, str(tmp_path / platform))
        images.append(dict(np.load(tmp_path / f"{platform}.npz")))
    for name, one in images[0].items():
        difference = np.abs(one - images[1][name])
        # Drivers may round an edge to the other side of a sample and filter textures with different precision; where
        # both are Mesa's software rasteriser the images are the same to the bit.
        assert difference.mean() < 1e-3, name
        assert np.quantile(difference, 0.99) < 0.02, name


_MEMORY = """
import ctypes, json, sys
import numpy as np, torch
from scene_attack.rendering.opengl import context
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from tests.unit.rendering import shapes

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 2**20

renderer = PyrenderRenderer(shapes.placed(shapes.scene((64, 64)), shapes.six_parts()))
generator = torch.Generator().manual_seed(0)
for frame in range(700):
    if frame == 50:
        before = resident()
    turn = torch.randn((1, 1, 3), generator=generator)
    image = renderer.render({"rotation": turn})
print(json.dumps({"grown": resident() - before, "backend": context.gl_backend(), "spread": float(image.std())}))
"""


@pytest.mark.parametrize("platform", PLATFORMS)
def test_many_frames_of_six_parts_hold_on_to_no_memory(platform: str) -> None:
    """With programs cached by the context object, as pyrender does, this grew by 0.8 MiB a frame on OSMesa."""
    answer = json.loads(on_platform(platform, _MEMORY))
    assert answer["backend"].startswith(platform)
    assert answer["spread"] > 0.01  # something was drawn
    assert answer["grown"] < 20  # MiB
