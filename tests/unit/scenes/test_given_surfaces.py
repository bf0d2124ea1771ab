"""A scene's metallic, roughness and floor: what they make of meshes, what is refused, and what stays without them."""

import numpy as np
import pytest
from pydantic import ValidationError

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.description import Floor, Scene
from scene_attack.scenes.mesh import Mesh
from scene_attack.scenes.resolve import canonical_json, floor_mesh, resolve, with_surface
from tests.unit.rendering.shapes import mesh, quad, sphere

CUBE = {"mesh": "primitive/cube"}
LEVEL = {"azimuth": 0.0, "elevation": 0.0}


def material(made: Mesh):
    [part] = made.parts
    assert part.metallic_roughness is not None
    return part.metallic_roughness


def texture(alpha: int) -> np.ndarray:
    texels = np.full((4, 4, 4), 200, np.uint8)
    texels[..., 3] = alpha
    texels[0, 0, 3] = 255
    return texels


def test_without_them_a_mesh_is_itself():
    one = mesh(sphere(0.5, 8))
    assert with_surface(one, None, None) is one


@pytest.mark.parametrize(("given", "made"), [((0.3, None), (0.3, 0.5)), ((None, 0.2), (0.0, 0.2)), ((1, 0), (1, 0))])
def test_one_that_is_left_out_has_its_default(given, made):
    found = material(with_surface(mesh(sphere(0.5, 8)), *given))
    assert (found.metallic, found.roughness) == made
    assert (found.alpha_mode, found.double_sided, found.given) == ("OPAQUE", True, True)


@pytest.mark.parametrize(
    ("alpha", "opacity", "mode"), [(255, 1, "OPAQUE"), (200, 1, "OPAQUE"), (100, 1, "MASK"), (100, 0.5, "BLEND")]
)
def test_a_texture_is_kept_with_its_holes_and_its_opacity(alpha, opacity, mode):
    texels = texture(alpha)
    made = with_surface(mesh(quad(color=(1, 0.5, 0, opacity), texture=texels)), 1.0, None)
    found = material(made)
    assert found.alpha_mode == mode
    assert made.parts[0].color[3] == pytest.approx(opacity)
    if mode == "BLEND":
        assert set(np.unique(found.maps["base_color"].texels[..., 3])) == {0, 255}
        assert texels[1, 1, 3] == alpha, "the mesh's own texture is not touched"
    else:
        assert found.maps["base_color"].texels is texels


def test_a_material_of_a_file_keeps_what_is_not_given(library):
    entry = library.add_mesh(_with_maps(), "glb")
    own, made = (library.mesh(entry.name), with_surface(library.mesh(entry.name), 0.25, 0.75))
    for before, after in zip(own.parts, made.parts, strict=True):
        was, now = before.metallic_roughness, after.metallic_roughness
        assert (now.metallic, now.roughness, now.given) == (0.25, 0.75, True)
        assert now.double_sided == was.double_sided
        assert set(now.maps) == set(was.maps) - {"metallic_roughness"}
        assert after.color is before.color


def _with_maps() -> bytes:
    from tests.unit.rendering.pyrender.test_gltf_materials import filled, square

    surface = {"metallicRoughnessTexture": filled(7, 191, 102), "baseColorTexture": filled(9, 9, 9)}
    return square({"pbrMetallicRoughness": surface, "occlusionTexture": filled(51, 0, 0)})


def test_the_floor_faces_up_at_its_height():
    [part] = floor_mesh(Floor(size=3, height=-0.7)).parts
    a, b, c = part.vertices[part.faces[0]]
    assert np.cross(b - a, c - a)[1] > 0
    assert part.vertices.min(0).tolist() == pytest.approx([-1.5, -0.7, -1.5])
    assert part.vertices.max(0).tolist() == pytest.approx([1.5, -0.7, 1.5])
    assert part.metallic_roughness is None


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"objects": [CUBE | {"metallic": 1.1}]}, ("objects", 0, "metallic")),
        ({"objects": [CUBE | {"roughness": -0.1}]}, ("objects", 0, "roughness")),
        ({"objects": [CUBE | {"roughness": float("nan")}]}, ("objects", 0, "roughness")),
        ({"objects": [CUBE], "floor": {"size": 0}}, ("floor", "size")),
        ({"objects": [CUBE], "floor": {"height": 1e9}}, ("floor", "height")),
        ({"objects": [CUBE], "floor": {"texture": "wood"}}, ("floor", "texture")),
    ],
)
def test_descriptions_out_of_range_are_refused_by_their_field(given, field):
    with pytest.raises(ValidationError) as refused:
        Scene.model_validate(given)
    assert refused.value.errors()[0]["loc"] == field


def test_descriptions_without_them_are_as_before():
    text = canonical_json(Scene.model_validate({"objects": [CUBE]}))
    assert not any(word in text for word in ("metallic", "roughness", "floor"))
    whole = Scene.model_validate({"objects": [CUBE | {"metallic": 0.0}], "floor": {}})
    assert Scene.model_validate_json(whole.model_dump_json()) == whole
    assert '"metallic":0.0' in canonical_json(whole)


def test_objects_of_the_same_mesh_and_surface_share_it(library):
    things = [CUBE | {"metallic": 1.0}, CUBE, CUBE | {"metallic": 1.0, "color": (1, 0, 0)}, CUBE | {"metallic": 0.5}]
    first, plain, same, other = resolve(Scene.model_validate({"objects": things}), library).meshes
    assert first is same
    assert len({id(one) for one in (first, plain, other)}) == 3


@pytest.mark.parametrize("floor", [{"height": 0.0}, {"height": 80.0, "size": 1.0}], ids=["edge-on", "out of the frame"])
def test_a_floor_that_cannot_be_seen_is_refused(library, floor):
    with pytest.raises(InvalidRequest, match="less than a pixel") as refused:
        resolve(Scene.model_validate({"objects": [CUBE], "camera": LEVEL, "floor": floor}), library)
    assert refused.value.field == "scene.floor"


def test_the_floor_is_before_the_far_plane(library):
    camera = {"azimuth": 0.7, "elevation": 0.5, "distance": 11.3}
    found = resolve(Scene.model_validate({"objects": [CUBE], "camera": camera, "floor": {"size": 200}}), library)
    corners = np.array([(x, 0.0, z, 1.0) for x in (-100, 100) for z in (-100, 100)])
    clip = corners @ (found.projection @ np.linalg.inv(found.view)).T
    assert (clip[:, 2] < clip[:, 3])[clip[:, 3] > 0].all()
