"""Textures and colours of mesh files, and the files and addresses that they name: none of those is opened."""

from io import BytesIO

import numpy as np
import pytest
import trimesh
from PIL import Image

from scene_attack.scenes.reading import surfaces
from scene_attack.scenes.reading.formats import read_mesh
from tests.unit.scenes.mesh_files import ASCII_PLY, MAX_FACES, RIGHT_TRIANGLE, assert_refused, glb, split_glb, triangle


def encoded(data):
    return data.encode() if isinstance(data, str) else data


def textured(width, height, alpha_mode=None):
    """A box with a texture of one colour as a glTF file."""
    out = BytesIO()
    Image.new("RGBA", (width, height), (10, 20, 30, 128)).save(out, "PNG")
    mesh = trimesh.creation.box()
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.open(out), baseColorFactor=(128, 255, 255, 128), alphaMode=alpha_mode
    )
    mesh.visual = trimesh.visual.TextureVisuals(uv=mesh.vertices[:, :2] + 0.5, material=material)
    return mesh.export(file_type="glb")


def test_a_glb_keeps_its_texture_and_linear_colour():
    (part,) = read_mesh(textured(6, 4), "glb", MAX_FACES)
    assert part.metallic_roughness.maps["base_color"].texels.shape == (4, 6, 4)
    assert (part.metallic_roughness.maps["base_color"].texels == (10, 20, 30, 128)).all()
    assert part.metallic_roughness.alpha_mode == "OPAQUE", "without an alpha mode glTF is opaque"
    assert np.allclose(part.color, [128 / 255, 1, 1, 1], atol=1e-3), "glTF factors are linear"
    (blended,) = read_mesh(textured(6, 4, "BLEND"), "glb", MAX_FACES)
    assert blended.metallic_roughness.alpha_mode == "BLEND"
    assert blended.color[3] == pytest.approx(128 / 255, abs=1e-3)


def test_face_and_vertex_colours_are_kept():
    mesh = trimesh.creation.box()
    colors = np.zeros((12, 4), np.uint8) + 255
    colors[:, 0] = np.arange(12) * 20
    mesh.visual.face_colors = colors
    (part,) = read_mesh(mesh.export(file_type="ply"), "ply", MAX_FACES)
    # Every colour has a texel, and all vertices of a face have the centre of theirs as uv.
    height, width = part.texture.shape[:2]
    column, row = part.uv[:, 0] * width - 0.5, (1 - part.uv[:, 1]) * height - 0.5
    assert np.allclose(column, np.rint(column), atol=1e-4)
    seen = part.texture[np.rint(row).astype(int), np.rint(column).astype(int)][part.faces]
    assert (seen == seen[:, :1]).all()
    assert sorted(seen[:, 0, 0]) == sorted(colors[:, 0])


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_without_its_texture_a_mesh_has_the_colour_of_one_that_states_none(kind):
    """The loader stands a darker grey in for the missing texture: 100 of 255 where a mesh without one has 204."""
    mesh = trimesh.creation.box()
    (plain,) = read_mesh(encoded(mesh.export(file_type=kind)), kind, MAX_FACES)
    image = Image.new("RGB", (4, 4), (250, 0, 0))
    mesh.visual = trimesh.visual.TextureVisuals(uv=mesh.vertices[:, :2] + 0.5, image=image)
    data = encoded(mesh.export(file_type=kind))
    (part,) = read_mesh(data, kind, MAX_FACES)
    assert part.texture is None
    assert (part.color == plain.color).all()
    assert part.color[0] == pytest.approx(((204 / 255 + 0.055) / 1.055) ** 2.4)


def test_a_texture_of_too_many_pixels_is_refused(monkeypatch):
    monkeypatch.setattr(surfaces, "MAX_TEXTURE_SOURCE", 6 * 4 - 1)
    assert_refused(textured(6, 4), "glb", "pixels")


@pytest.mark.parametrize("address", ["http://127.0.0.1:9/a.bin", "file:///etc/passwd", "/etc/passwd", "../a.bin"])
def test_files_and_addresses_that_a_mesh_names_are_not_opened(address, monkeypatch):
    opened = []
    monkeypatch.setattr("builtins.open", lambda *a, **_: opened.append(a) or (_ for _ in ()).throw(OSError("closed")))
    monkeypatch.setattr(
        "socket.socket.connect", lambda *a: opened.append(a) or (_ for _ in ()).throw(OSError("closed"))
    )
    obj = f"mtllib {address}\nusemtl a\n".encode() + triangle("obj", RIGHT_TRIANGLE)
    assert read_mesh(obj, "obj", MAX_FACES)[0].texture is None
    ply = ASCII_PLY.replace(b"element vertex", f"comment TextureFile {address}\nelement vertex".encode(), 1)
    assert read_mesh(ply, "ply", MAX_FACES)[0].texture is None
    tree, body = split_glb(triangle("glb", RIGHT_TRIANGLE))
    tree["buffers"].insert(0, {"uri": address, "byteLength": 36})
    tree["bufferViews"][0]["buffer"] = 0
    assert_refused(glb(tree, body), "glb", "not a readable")
    assert opened == []
