"""The committed split, and the rules that made it."""

from collections import Counter
from itertools import chain
from pathlib import Path

import numpy as np
import torch

from scene_attack.scenes.furniture import PREFIX, Model, kind_of
from scene_attack.scenes.primitives import primitive
from training.split import (
    AT_MOST,
    CLASSES,
    FOLDS,
    MIN_FAMILIES,
    MIN_HELD_OUT,
    Samples,
    Split,
    choose,
    committed,
    cross_validated,
    distance,
    divided,
    families,
    folds,
    stem,
)


def _model(slug: str, creator: str, path: str) -> Model:
    return Model(
        slug=slug,
        key=slug,
        title=slug,
        category="",
        creator=creator,
        licence="",
        library="L",
        archive=Path(),
        path=path,
        size=(1, 1, 1),
        rotation=(1, 0, 0, 0, 1, 0, 0, 0, 1),
    )


def test_no_model_and_no_family_is_on_both_sides():
    split = committed()
    for kind in split.classes:
        training, held_out = set(split.training[kind]), set(split.held_out[kind])
        assert not training & held_out
        assert len({split.family(kind, slug) for slug in training}) >= MIN_FAMILIES
        assert len({split.family(kind, slug) for slug in held_out}) >= MIN_HELD_OUT
        for family in split.families[kind]:
            assert set(family) <= training or set(family) <= held_out


def test_every_model_has_the_kind_of_its_class():
    split = committed()
    assert len(split.classes) == len(set(split.classes)) >= 14
    for side in ("training", "held_out"):
        assert all(kind_of(PREFIX + slug) == split.classes[number] for number, slug in split.models(side))
    shares = [len(split.held_out[kind]) / len(split.held_out[kind] + split.training[kind]) for kind in split.classes]
    assert min(shares) >= 0.1
    assert max(shares) <= AT_MOST


def test_the_rounds_drop_the_kind_of_lowest_recall():
    split: Split = committed()
    assert [one.kinds for one in split.rounds] == list(range(len(split.classes) + len(split.rounds), CLASSES, -1))
    assert not {one.dropped for one in split.rounds} & set(split.classes)
    assert min(split.recalls.values()) >= max(0.0, min(one.recall for one in split.rounds))


def test_families_are_by_set_by_file_name_and_by_shape():
    studio = {f"other-{k}": _model(f"other-{k}", "Studio", f"o{k}.obj") for k in range(60)}
    models = studio | {
        "window-a": _model("window-a", "Studio", "a/window_2x3.obj"),
        "window-b": _model("window-b", "Studio", "b/Window_4x5_arched.obj"),
        "window-c": _model("window-c", "Studio", "c/sliding.obj"),
        "window-d": _model("window-d", "Ann", "d/one.obj"),
        "window-e": _model("window-e", "Ann", "e/two.obj"),
        "window-f": _model("window-f", "Bob", "f/three.obj"),
    }
    # "c" and "f" have one shape, though their makers differ.
    shapes = dict.fromkeys(["window-c", "window-f"], "torus")
    shapes |= {"window-a": "cube", "window-b": "sphere", "window-d": "cone", "window-e": "cylinder"}
    slugs = sorted(shapes)
    found = families(models, {"window": slugs}, lambda slug: primitive(shapes[slug]))
    assert sorted(map(sorted, found["window"])) == [
        ["window-a", "window-b"],
        ["window-c", "window-f"],
        ["window-d", "window-e"],
    ]
    assert stem(models["window-b"]) == "window"


def test_shapes_are_compared_in_four_turns():
    random = np.random.default_rng(0)
    cloud = random.random((500, 3)) - 0.5
    turned = np.stack([cloud[:, 2], cloud[:, 1], -cloud[:, 0]], axis=1)
    assert distance(cloud, turned) < 1e-12
    assert distance(cloud, cloud + np.array([0, 0.5, 0])) > 0.1


def test_division_holds_out_whole_families_of_every_kind():
    groups = {"a": [[f"a{k}"] for k in range(20)], "b": [[f"b{k}" for k in range(20)]], "c": [["c0"], ["c1"]]}
    training, held_out = divided(groups, 0)
    assert set(training) == {"a"}  # "b" is one family, "c" too small
    assert len(held_out["a"]) == 5
    assert divided(groups, 1)[1] != held_out


def test_folds_keep_families_together():
    groups = {f"m{k}": f"f{k // 3}" for k in range(24)}
    found = folds(groups, list(groups))
    assert all(len({found[slug] for slug in groups if groups[slug] == name}) == 1 for name in groups.values())
    assert Counter(found.values()) == dict.fromkeys(range(FOLDS), 6)


def test_classes_that_cannot_be_told_apart_are_dropped():
    """Of 16 kinds two have the features of others; no view of another fold tells them apart."""
    random = torch.Generator().manual_seed(0)
    n, kinds = 40, 16
    truth = torch.arange(kinds).repeat_interleave(n)
    looks_like = torch.where(truth == 3, 2, torch.where(truth == 7, 6, truth))
    features = torch.nn.functional.one_hot(looks_like, kinds) + 0.1 * torch.randn(n * kinds, kinds, generator=random)
    samples = Samples(features, truth, torch.arange(n).remainder(FOLDS).repeat(kinds))
    accuracy, recalls = cross_validated(samples, range(kinds))
    assert accuracy < 1
    assert all(recalls[kind] == 1 for kind in (0, 1, 4, 5, 8, 15))
    chosen, accuracy, _, rounds = choose(samples, [str(kind) for kind in range(kinds)], lambda _: None)
    dropped = {one.dropped for one in rounds}
    assert len(chosen) == CLASSES
    assert len(dropped & {"2", "3"}) == len(dropped & {"6", "7"}) == 1
    assert accuracy == 1.0


def test_models_are_listed_class_by_class():
    split = committed()
    listed = split.models("held_out")
    assert [number for number, _ in listed] == sorted(number for number, _ in listed)
    assert len(listed) == len(list(chain.from_iterable(split.held_out.values())))
