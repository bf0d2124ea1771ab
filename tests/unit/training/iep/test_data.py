from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from scene_attack.scenes.library import Library
from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.executor import Facts, answer
from tests.unit.training.iep.small import SEED, After, never, silent
from training.iep import data
from training.iep.data import DataFolder, Images, examples_of, objects_of
from training.iep.recipe import RECIPE, Part

pytestmark = pytest.mark.slow

TWO = {"pyrender": 0.75, "torch": 0.25}


@pytest.fixture
def folder(tmp_path: Path, library: Library, monkeypatch: pytest.MonkeyPatch) -> DataFolder:
    """Two shards for training, by either renderer; in place of an image there is its scene's number of objects."""
    monkeypatch.setattr(data, "SHARD", 4)
    monkeypatch.setattr(data, "draw", lambda scene, *_: np.full((240, 320, 3), len(scene.objects), np.uint8))
    recipe = replace(RECIPE, shares=TWO, scenes={"train": 8, "validation": 2, "test": 4}, questions=5)
    made = DataFolder(tmp_path, recipe, SEED)
    assert made.draw_missing(("train", "validation", "test"), library, silent, never)
    return made


def test_parts_have_their_shares_and_the_test_split_both_kinds_of_scenes() -> None:
    for split, kinds in (("train", 1), ("validation", 1), ("test", 2)):
        parts = RECIPE.parts(split)
        assert sum(part.scenes for part in parts) == kinds * RECIPE.scenes[split]
        for name, share in RECIPE.shares.items():
            own = sum(part.scenes for part in parts if part.renderer == name)
            assert abs(own - share * kinds * RECIPE.scenes[split]) <= kinds
    assert {part.objects for part in RECIPE.parts("test")} == {(3, 6), (3, 10)}
    assert RECIPE.scaled(1) is RECIPE
    assert RECIPE.scaled(1e-4).scenes == {"train": 1, "validation": 1, "test": 1}


def test_no_scene_is_in_two_parts(folder: DataFolder) -> None:
    pieces = [piece for split in ("train", "validation", "test") for piece in folder.pieces(split)]
    scenes = [scene for piece in pieces for scene in folder.read(piece).scenes]
    assert len(scenes) == 8 + 2 + 2 * 4
    assert len({scene.model_dump_json(include={"objects"}) for scene in scenes}) == len(scenes)
    for piece in pieces:
        least, most = piece.part.objects
        assert all(least <= len(scene.objects) <= most for scene in folder.read(piece).scenes)


def test_images_objects_and_questions_are_numbered_alike(folder: DataFolder) -> None:
    shards = folder.read_all("train")
    assert [len(shard) for shard in shards] == [4, 2, 2]
    images, objects, examples = Images(shards), objects_of(shards), list(examples_of(shards))
    assert len(images) == len(objects) == 8
    assert [int(image[0, 0, 0]) for image in images(range(8))] == [len(of) for of in objects]
    records = [scene for shard in shards for scene in shard.scenes]
    assert [example.image for example in examples] == sorted(example.image for example in examples)
    assert len(examples) == 8 * 5
    for example in examples:
        assert answer(example.program, Facts.of(records[example.image])) == example.answer
        assert set(example.results[0]) == set(range(len(objects[example.image])))
    part = Part("train", "torch", (3, 10), 2)
    assert records[6].objects == generate(SEED, 0, objects=(3, 10), split=part.name).objects


def test_several_processes_draw_the_same_files_as_one(
    tmp_path: Path, library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(data, "SHARD", 1)
    recipe = replace(RECIPE, shares={"pyrender": 1.0}, scenes={"train": 2, "validation": 1, "test": 1}, questions=2)
    one, two = (DataFolder(tmp_path / name, recipe, SEED) for name in ("one", "two"))
    assert one.draw_missing(("train", "validation"), library, silent, never)
    said: list[float] = []
    assert not two.draw_missing(("train",), library, lambda _, done, *__: said.append(done), After(1), processes=2)
    assert said == [1]
    assert two.draw_missing(("train", "validation"), library, silent, never, processes=2)
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert files == sorted(path.name for path in (tmp_path / "two").iterdir())
    assert len(files) == 3
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_drawing_goes_on_with_the_first_renderer_first(folder: DataFolder, library: Library) -> None:
    digest = folder.digest("train")
    paths = [folder.path(piece) for piece in folder.pieces("train")]
    for path in paths:
        path.unlink()
    said: list[float] = []
    for wanted in (1, 2):
        assert not folder.draw_missing(("test", "train"), library, lambda _, done, *__: said.append(done), After(1))
        assert sum(path.exists() for path in paths) == wanted
    assert paths[0].exists()
    assert not paths[2].exists()
    assert folder.draw_missing(("test", "train"), library, lambda _, done, *__: said.append(done), never)
    assert all(one < other for one, other in pairwise(said))
    assert said[-1] == 16
    assert folder.digest("train") == digest
