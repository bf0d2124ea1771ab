"""The table of truths names models and kinds that the library has, and labels that ImageNet has."""

from scene_attack.scenes.furniture import PREFIX, kinds
from scene_attack.scenes.library import Library
from scene_attack.targets.labels import imagenet_labels, imagenet_table, same_labels, truth_labels
from scene_attack.targets.registry import card
from scene_attack_service.settings import Settings

IMAGENET = card("efficientnet-lite0")


def test_every_mesh_and_kind_of_the_table_is_in_the_library() -> None:
    table = imagenet_table()
    library = {entry.name for entry in Library(Settings().cache_dir, Settings().data_dir).entries()}
    assert [mesh for mesh in table["meshes"] if PREFIX + mesh not in library] == []
    assert [kind for kind in table["kinds"] if kind not in kinds()] == []


def test_every_label_of_the_table_is_one_of_imagenet_s() -> None:
    table, labels = imagenet_table(), set(imagenet_labels())
    rows = [*table["kinds"].values(), *table["meshes"].values(), *table["same"]]
    assert [label for row in rows for label in row if label not in labels] == []
    assert all(len(set(row)) == len(row) for row in rows)
    assert all(table["kinds"].values()), "a kind without labels is left out"


def test_a_label_means_the_same_as_those_of_one_group_at_most() -> None:
    groups = same_labels(IMAGENET)
    assert all(len(group) > 1 for group in groups)
    assert len(frozenset().union(*groups)) == sum(len(group) for group in groups)
    assert frozenset({"sunglass", "sunglasses"}) in groups
    assert frozenset({"maillot", "maillot (one-piece)"}) in groups


def test_a_truth_has_all_labels_that_mean_the_same() -> None:
    """Otherwise the table would call wrong what the goal leaves together."""
    table = imagenet_table()
    for mesh in (PREFIX + name for name in table["meshes"]):
        truth = set(truth_labels(IMAGENET, mesh))
        assert [group for group in same_labels(IMAGENET) if truth & group and not group <= truth] == [], mesh


def test_a_mesh_goes_before_its_kind_and_a_doubt_before_both() -> None:
    table = imagenet_table()
    both = [mesh for kind in table["kinds"] for mesh in kinds()[kind] if mesh.removeprefix(PREFIX) in table["meshes"]]
    assert both
    for mesh in both:
        assert list(truth_labels(IMAGENET, mesh)) == table["meshes"][mesh.removeprefix(PREFIX)]
    assert any(truth_labels(IMAGENET, mesh) == () for mesh in both)


def test_a_dog_is_no_one_breed() -> None:
    """A bulldog is taken for a boxer, then for a bull mastiff: neither answer is an error that an attack made."""
    assert {"boxer", "bull mastiff", "French bulldog"} <= set(truth_labels(IMAGENET, "furniture/bulldog"))
    assert set(truth_labels(IMAGENET, "furniture/sunglasses")) == {"sunglass", "sunglasses"}
    assert truth_labels(IMAGENET, "furniture/grand-piano") == ("grand piano",)
