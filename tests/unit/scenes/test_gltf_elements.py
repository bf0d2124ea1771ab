"""GLB files in which an element of the JSON is missing or of another type: the message says which."""

from typing import Any

import pytest

from benchmarks.gltf_models import Writer
from services.errors import InvalidRequest
from tests.unit.scenes.test_gltf import one, read


def primitive(writer: Writer) -> dict[str, Any]:
    found: dict[str, Any] = writer.tree["meshes"][0]["primitives"][0]
    return found


FIRST = "meshes[0].primitives[0]"
BAD: dict[str, tuple[Writer, str]] = {
    "no positions": (
        one(edit=lambda w: primitive(w)["attributes"].pop("POSITION")),
        f"{FIRST} has no attributes.POSITION",
    ),
    "no attributes": (one(edit=lambda w: primitive(w).pop("attributes")), f"{FIRST} has no attributes.POSITION"),
    "no primitive": (one(edit=lambda w: w.tree["meshes"][0].update(primitives=[None])), f"{FIRST} is not an object"),
    "no list": (one(edit=lambda w: w.tree["meshes"][0].update(primitives={})), "meshes[0].primitives is not a list"),
    "mode": (one(edit=lambda w: primitive(w).update(mode="triangles")), f"{FIRST}.mode is 'triangles'"),
    "no count": (one(edit=lambda w: w.tree["accessors"][0].pop("count")), "accessors[0].count is None"),
    "a list as a type": (one(edit=lambda w: w.tree["accessors"][0].update(type=["VEC3"])), "accessors[0] has the type"),
    "a list as a component": (one(edit=lambda w: w.tree["accessors"][0].update(componentType=[5126])), "accessors[0]"),
    "numbers as indices": (one(edit=lambda w: primitive(w).update(indices=[0, 1, 2])), "accessors[[0, 1, 2]]"),
    "a list as a material": (one(edit=lambda w: primitive(w).update(material=[0])), "materials[[0]]"),
    "no mesh": (one(edit=lambda w: w.tree.update(meshes=[None])), "meshes[0] is not an object"),
    "no view": (one(edit=lambda w: w.tree.update(bufferViews=[None, None])), "bufferViews[0] is not an object"),
    "no children": (one(edit=lambda w: w.tree["nodes"][0].update(children=1)), "nodes[0].children is not a list"),
    "roots": (one(edit=lambda w: w.tree["scenes"][0].update(nodes=0)), "scenes[0].nodes is not a list"),
}


@pytest.mark.parametrize("case", BAD)
def test_the_element_is_named(case: str) -> None:
    writer, words = BAD[case]
    with pytest.raises(InvalidRequest) as error:
        read(writer)
    assert error.value.field == "file"
    assert words in error.value.detail
    assert "Error" not in error.value.detail
