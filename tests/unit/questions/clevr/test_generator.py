"""Generated scenes: that they are repeatable, what is placed where, and what is seen of it."""

from collections import Counter
from itertools import combinations, product
from math import cos, hypot, radians, sin

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.scenes.primitives import primitive
from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import MIN_PIXELS, check, generate, object_numbers, overlap, visible_pixels
from scene_attack_questions.clevr.records import ATTRIBUTES, RADIUS, ObjectRecord, Rig, Vector, half_height
from tests.unit.rendering.shapes import placed

SCENES = [generate(7, k, split="test") for k in range(120)]


def test_a_scene_depends_on_seed_split_and_index_alone() -> None:
    assert generate(7, 60, split="test") == SCENES[60]
    others = [generate(8, 60, split="test"), generate(7, 60, split="train"), SCENES[61]]
    assert all(other.objects != SCENES[60].objects for other in others)


def test_number_of_objects_is_uniform_within_its_bounds() -> None:
    counts = Counter(len(scene.objects) for scene in SCENES)
    assert set(counts) == set(range(3, 11))
    assert max(counts.values()) < 30  # 15 each are expected, with a standard deviation of 3.6
    assert {len(generate(0, k, objects=(4, 5)).objects) for k in range(20)} == {4, 5}


def test_objects_keep_their_distances_and_stand_on_the_plane() -> None:
    for scene in SCENES:
        for one in scene.objects:
            x, y, z = one.coords_3d
            assert abs(x) <= 3
            assert abs(y) <= 3
            assert z == half_height(one.shape, one.size)
        for one, other in combinations(scene.objects, 2):
            offset = [a - b for a, b in zip(one.coords_3d, other.coords_3d, strict=True)]
            assert hypot(offset[0], offset[1]) >= RADIUS[one.size] + RADIUS[other.size] + 0.25
            for name in ("right", "behind"):
                along = scene.directions[name]
                assert abs(offset[0] * along[0] + offset[1] * along[1]) >= 0.4


def test_every_pair_of_objects_is_related_in_both_directions() -> None:
    for scene in SCENES:
        everything = set(range(len(scene.objects)))
        for first, second in (("left", "right"), ("front", "behind")):
            for k in everything:
                here, there = set(scene.relationships[first][k]), set(scene.relationships[second][k])
                assert here | there == everything - {k}
                assert not here & there


def test_attributes_take_every_value_about_as_often() -> None:
    objects = [one for scene in SCENES for one in scene.objects]
    for attribute, values in ATTRIBUTES.items():
        counts = Counter(one.value(attribute) for one in objects)
        assert set(counts) == set(values)
        if attribute != "size":  # large objects fit less often
            assert max(counts.values()) < 1.6 * min(counts.values())


def test_camera_and_lights_are_jittered_within_their_bounds() -> None:
    base = Rig()
    rigs = [scene.rig for scene in SCENES]
    for name, most in (("camera", 0.5), ("key", 1.0), ("fill", 1.0), ("back", 1.0)):
        for axis in range(3):
            moves = [getattr(rig, name)[axis] - getattr(base, name)[axis] for rig in rigs]
            assert 0.9 * most < max(moves) <= most
            assert -most <= min(moves) < -0.9 * most


def test_more_objects_than_fit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scene_attack_questions.clevr.generator.RESTARTS", 3)
    with pytest.raises(InvalidRequest, match="40 objects do not fit"):
        generate(0, 0, objects=(40, 40))


def test_hidden_objects_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scene_attack_questions.clevr.generator.MIN_PIXELS", 100_000)
    monkeypatch.setattr("scene_attack_questions.clevr.generator.DISCARDS", 3)
    with pytest.raises(InvalidRequest, match="cannot all be seen"):
        generate(0, 0)


SHAPES = ("cube", "sphere", "cylinder")


def solid(shape: str, size: str, centre: Vector, rotation: float = 0.0) -> ObjectRecord:
    about = {"shape": shape, "size": size, "color": "red", "material": "metal", "rotation": rotation}
    return ObjectRecord.model_validate(about | {"coords_3d": centre, "pixel_coords": (0, 0, 0.0)})


def standing(shape: str, size: str, x: float, y: float, rotation: float = 0.0) -> ObjectRecord:
    return solid(shape, size, (x, y, half_height(shape, size)), rotation)


def at(one: ObjectRecord, centre: Vector) -> ObjectRecord:
    return one.model_copy(update={"coords_3d": centre})


def directions() -> np.ndarray:
    """Unit vectors, one in each degree of both angles of the upper half of a sphere."""
    turn, height = np.meshgrid(np.arange(0, 360) * np.pi / 180, np.arange(-45, 46) * np.pi / 180)
    flat = np.cos(height)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(height)], -1).reshape(-1, 3)


def extent(one: ObjectRecord, along: np.ndarray) -> np.ndarray:
    """How far a solid reaches from its centre in each direction."""
    radius = {"small": 0.35, "large": 0.7}[one.size]
    if one.shape == "sphere":
        return np.full(len(along), radius)
    if one.shape == "cylinder":
        return radius * (np.hypot(along[:, 0], along[:, 1]) + abs(along[:, 2]))
    angle, half = radians(one.rotation), radius / 2**0.5
    axes = np.array([[cos(angle), sin(angle), 0], [-sin(angle), cos(angle), 0], [0, 0, 1]])
    return half * abs(along @ axes.T).sum(1)


def gap(one: ObjectRecord, other: ObjectRecord) -> float:
    """The largest gap between the projections of two solids on a direction; below 0 no plane separates them."""
    along = directions()
    return float(
        (along @ np.subtract(other.coords_3d, one.coords_3d) - extent(one, along) - extent(other, along)).max()
    )


@pytest.mark.parametrize(("first", "second"), list(product(SHAPES, repeat=2)))
def test_solids_overlap_unless_a_plane_separates_them(first: str, second: str) -> None:
    rng = np.random.default_rng(0)
    reach, seen = {"small": 0.35, "large": 0.7}, set()
    for _ in range(60):
        sizes = [str(size) for size in rng.choice(["small", "large"], 2)]
        away, turn = (reach[sizes[0]] + reach[sizes[1]]) * rng.uniform(0.6, 1.05), rng.uniform(0, 2 * np.pi)
        one = standing(first, sizes[0], 0, 0, rng.uniform(0, 360))
        other = standing(second, sizes[1], away * np.cos(turn), away * np.sin(turn), rng.uniform(0, 360))
        found = gap(one, other)
        if abs(found) > 0.015:  # half a degree, at the distance of a corner
            assert overlap(one, other) == overlap(other, one) == (found < 0), (one, other, found)
            seen.add(found < 0)
    assert seen == {True, False}


def test_generated_scenes_pass() -> None:
    for k in range(30):
        scene = generate(2, k)
        check(scene.objects, scene.rig)


@pytest.mark.parametrize(
    ("move", "said"),
    [
        ((0.0, 0.0, 0.02), "floats above the plane by 0.02"),
        ((0.0, 0.0, -0.3), "sinks into the plane by 0.3"),
        ((9.0, 0.0, 0.0), "not inside the frame"),
        ((-1.9, 0.0, 0.0), "overlaps object 0"),
    ],
)
def test_a_misplaced_object_is_refused(move: tuple[float, float, float], said: str) -> None:
    first, second = standing("cube", "large", -1, 0, 30), standing("sphere", "large", 1, 0)
    check([first, second], Rig())
    x, y, z = (a + b for a, b in zip(second.coords_3d, move, strict=True))
    with pytest.raises(InvalidRequest, match=said) as caught:
        check([first, at(second, (x, y, z))], Rig())
    assert caught.value.field == "objects.1"


def test_an_object_above_another_does_not_overlap_it() -> None:
    for one, other in product(SHAPES, repeat=2):
        below = standing(one, "small", 0, 0, 20)
        above = solid(other, "small", (0, 0, 0.71 + half_height(other, "small")))
        assert not overlap(below, above)
        assert overlap(below, at(above, (0, 0, half_height(one, "small") + 0.1)))


@pytest.mark.parametrize("index", range(4))
def test_the_image_is_that_of_the_g_buffer_but_for_silhouettes(index: int) -> None:
    scene = generate(3, index)
    description = describe(scene)
    buffer = rasterise(placed(description, *(primitive(o.mesh.split("/")[1]) for o in description.objects)))
    drawn = np.where(buffer.coverage.numpy() >= 0.5, buffer.object_index.numpy(), -1)
    drawn[drawn >= len(scene.objects)] = -1  # a floor is no object
    numbers = object_numbers(scene.objects, scene.rig)
    silhouettes = np.zeros(numbers.shape, bool)
    for k in (-1, *range(len(scene.objects))):
        silhouettes |= binary_dilation(numbers == k) & (numbers != k)
    different = numbers != drawn
    assert not (different & ~silhouettes).any()
    # A polygon lies within its circle, and a pixel's centre is not all of it: under a tenth of the silhouettes' pixels.
    assert different.sum() < 0.1 * silhouettes.sum()


def test_generated_objects_are_seen_in_enough_pixels() -> None:
    for index in range(40):
        scene = generate(4, index)
        assert min(visible_pixels(scene.objects, scene.rig)) >= MIN_PIXELS


def test_an_object_behind_another_is_hidden_by_it() -> None:
    rig = Rig()
    near = solid("sphere", "large", (0.0, 0.0, 0.7))
    # The centre of the second lies on the ray from the eye through the first's.
    far = solid("sphere", "small", (-1.5 * 7.4811, 1.5 * 6.5076, 0.7 - 1.5 * 4.6437))
    alone, hidden = visible_pixels([far], rig), visible_pixels([near, far], rig)
    assert alone[0] > 50
    assert hidden[1] == 0
    assert visible_pixels([far, near], rig) == hidden[::-1]
