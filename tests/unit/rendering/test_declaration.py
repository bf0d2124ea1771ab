"""Declarations: what they say of the built-in renderers, and what cannot be declared."""

from math import inf, nan

import pytest

from scene_attack.rendering.declaration import RENDERERS, Declaration, DeclaredRenderer, Group, labelled, register
from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.rendering.torch.declaration import TORCH

FOG = Group(name="fog", shape=("H", "W"), unit="1/m", words="fog")


def test_the_built_in_renderers_are_found() -> None:
    assert RENDERERS["image"].group_names == ("image",)
    papers = ("illumination", "color", "translation", "rotation")
    assert RENDERERS["pyrender"].default_groups == papers
    assert RENDERERS["pyrender"].group_names == (*papers, "camera")
    assert RENDERERS["torch"].default_groups == ("normals", "illumination", "material")
    of_torch = "normals illumination illumination_rgb material bump dials paint lamp shape translation rotation camera"
    assert RENDERERS["torch"].group_names == tuple(of_torch.split())


def test_labels_follow_the_axes() -> None:
    labels = labelled("object {}", ("red", "green"))
    assert labels((2, 2)) == ["object 0 red", "object 0 green", "object 1 red", "object 1 green"]
    with pytest.raises(ValueError, match="zip"):
        labels((2, 2, 2))


def test_labels_of_the_built_in_groups() -> None:
    colors = PYRENDER.group("color").labels
    material = TORCH.group("material").labels
    assert colors is not None
    assert material is not None
    assert colors((2, 3))[::5] == ["object 0 color red", "object 1 color blue"]
    assert len(colors((2, 3))) == 6
    assert material((2, 3, 3, 2, 6))[-1] == "object 1 blue lobe 2 gamma 5"
    assert len(material((2, 3, 3, 2, 6))) == 2 * 3 * 3 * 2 * 6


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"shape": ()}, "declares no shape"),
        ({"shape": ("H", "0")}, "axis of length 0"),
        ({"shape": ("H", "")}, "a tuple of a word for each axis"),
        ({"shape": ("H", 3)}, "a tuple of a word for each axis"),
        ({"shape": "HW"}, "a tuple of a word for each axis"),
        ({"vector_axes": 3}, "has 2 axes, not vectors of 3"),
        *(({"suggested_step": step}, "suggests the step") for step in (nan, inf, -1.0, 0.0, 1001.0, "0.1")),
    ],
)
def test_a_group_that_cannot_be(changes: dict[str, object], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Group(**{"name": "fog", "shape": ("H", "W"), "unit": "1/m", "words": "fog"} | changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(("groups", "why"), [((), "no parameter group"), ((FOG, FOG), "a group twice")])
def test_a_renderer_that_cannot_be(groups: tuple[Group, ...], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Declaration(name="foggy", groups=groups, differentiable=True, method="fgsm")


def test_groups_on_request_are_not_attacked_by_default() -> None:
    rain = Group(name="rain", shape=("H",), unit="mm", words="rain", by_default=False)
    declared = Declaration(name="foggy", groups=(FOG, rain), differentiable=True, method="fgsm")
    assert (declared.group_names, declared.default_groups) == (("fog", "rain"), ("fog",))
    with pytest.raises(ValueError, match="no group that is attacked by default"):
        Declaration(name="rainy", groups=(rain,), differentiable=True, method="fgsm")


def test_a_location_that_is_none_is_refused() -> None:
    for location in ("module", "module:", "a module:Class"):
        with pytest.raises(ValueError, match="which is not module:class"):
            Declaration(name="foggy", groups=(FOG,), differentiable=True, method="fgsm", renderer=location)


def test_a_class_without_its_methods_is_refused() -> None:
    class Foggy(DeclaredRenderer):
        def render(self) -> None: ...

    declaration = Declaration(name="foggy", groups=(FOG,), differentiable=True, method="fgsm")
    with pytest.raises(ValueError, match="Foggy has no build and no initial and no bounds and no exact"):
        register(declaration)(Foggy)
    assert "foggy" not in RENDERERS
