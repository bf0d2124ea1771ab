"""Names of a scene's objects."""

from services.scenes.description import Scene, object_names


def test_objects_are_called_by_meshes_that_no_other_has() -> None:
    meshes = ("furniture/drill", "primitive/cube", "primitive/cube", "sha256:" + "0" * 64)
    scene = Scene.model_validate({"objects": [{"mesh": mesh} for mesh in meshes]})
    assert object_names(scene, {}) == ["drill", "object 1", "object 2", "object 3"]
    assert object_names(scene, {meshes[3]: "vase"}) == ["drill", "object 1", "object 2", "vase"]
    assert object_names(scene, {meshes[3]: "drill"}) == [f"object {k}" for k in range(4)]
