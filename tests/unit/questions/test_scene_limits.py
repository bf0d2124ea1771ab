"""The perturbations that a CLEVR scene allows, against distances, outlines and answers that are found here anew."""

from math import dist, hypot

import pytest
import torch

from scene_attack.rendering.protocol import Parameters
from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.clevr.records import RADIUS, RGB, SceneRecord
from scene_attack_questions.executor import Facts, answer, kind_asked
from scene_attack_questions.program import Program
from scene_attack_questions.scene_limits import SceneLimits
from scene_attack_questions.task import AskedQuestion
from tests.unit.questions.iep.seeded import program

pytestmark = pytest.mark.slow

RECORD = generate(8, 2, objects=(5, 5))
SCENE = describe(RECORD)


def question(asked: Program, record: SceneRecord = RECORD) -> AskedQuestion:
    right = answer(asked, Facts.of(record))
    return AskedQuestion("target.question", None, "", asked, kind_asked(asked), right, record, describe(record))


def initial() -> Parameters:
    of = {"color": "color", "translation": "translation", "rotation": "rotation"}
    values = {name: torch.tensor([getattr(o, field) for o in SCENE.objects]).double() for name, field in of.items()}
    return values | {"illumination": torch.ones(13, dtype=torch.float64)}


def nothing() -> Parameters:
    return {group: torch.zeros_like(value) for group, value in initial().items()}


def limits_of(questions: list[AskedQuestion], values: Parameters) -> SceneLimits:
    programs = [asked.program for asked in questions]
    return SceneLimits(programs, questions[0].record, questions[0].scene, "pyrender", values)


def limits(asked: Program) -> SceneLimits:
    return limits_of([question(asked)], initial())


COUNT = program("scene", "count 0")


def towards(k: int, j: int, share: float) -> Parameters:
    """Object k moved by a share of the way to object j."""
    found = nothing()
    (ax, ay, _), (bx, by, _) = RECORD.objects[k].coords_3d, RECORD.objects[j].coords_3d
    found["translation"][k] = torch.tensor([share * (bx - ax), 0.0, -share * (by - ay)])
    return found


def spheres_apart(perturbation: Parameters, k: int) -> bool:
    """Whether no circle around an object in the plane meets that of object k."""
    places = initial()["translation"] + perturbation["translation"]
    return all(
        hypot(*(places[k] - places[j])[[0, 2]].tolist())
        > RADIUS[RECORD.objects[k].size] + RADIUS[RECORD.objects[j].size]
        for j in range(len(RECORD.objects))
        if j != k
    )


def test_the_paper_s_parameters_are_free() -> None:
    fixed = limits(COUNT).fixed
    free = {group: int((~mask).sum()) for group, mask in fixed.items()}
    assert free == {"illumination": 12, "color": 3 * 5, "translation": 2 * 5, "rotation": 5}
    assert fixed["translation"][:, 1].all()
    assert not fixed["rotation"][:, 1].any()
    assert fixed["illumination"][0]


def test_nothing_is_allowed_and_a_collision_is_not() -> None:
    found = limits(COUNT)
    assert found.holds(nothing())
    assert not found.holds(towards(0, 1, 0.98))
    projected = found.project(towards(0, 1, 0.98))
    assert found.holds(projected)
    moved = float(projected["translation"][0].norm())
    assert moved > 0
    # one step of the search further it is not allowed
    whole = towards(0, 1, 0.98)
    further = moved / float(whole["translation"][0].norm()) + 1.01 / 256
    assert not found.holds(towards(0, 1, 0.98 * further))


def test_what_is_allowed_stays_as_it_is() -> None:
    perturbation = towards(0, 1, 0.02)
    perturbation["illumination"] += 0.3
    assert limits(COUNT).project(perturbation) is perturbation
    assert spheres_apart(perturbation, 0)


def test_leaving_the_frame_is_not_allowed() -> None:
    perturbation = nothing()
    perturbation["translation"][2, 0] = 30.0
    found = limits(COUNT)
    assert not found.holds(perturbation)
    assert found.holds(found.project(perturbation))


def test_lights_keep_their_change_when_objects_are_brought_back() -> None:
    perturbation = towards(0, 1, 0.98)
    perturbation["illumination"] += 0.3
    perturbation["color"][3] += 0.01
    projected = limits(COUNT).project(perturbation)
    assert torch.equal(projected["illumination"], perturbation["illumination"])
    assert torch.equal(projected["color"], perturbation["color"])


def recoloured(k: int, color: str) -> Parameters:
    found = nothing()
    found["color"][k] = torch.tensor(RGB[color]) / 255 - initial()["color"][k]
    return found


def test_a_colour_that_is_asked_about_may_not_become_another() -> None:
    own = RECORD.objects[0].color
    other = next(color for color in RGB if color not in {one.color for one in RECORD.objects})
    asked = limits(program("scene", f"filter_color 0 {own}", "count 1"))
    perturbation = recoloured(0, other)
    assert limits(COUNT).holds(perturbation)  # no one asks about colours
    assert not asked.holds(perturbation)
    projected = asked.project(perturbation)
    assert asked.holds(projected)
    share = float(projected["color"][0].norm() / perturbation["color"][0].norm())
    # a third of the way to a colour it is half as near to its own, unless a third colour is nearer before
    assert 0 < share <= 1 / 3 + 1 / 256
    counted = question(program("scene", f"filter_color 0 {own}", "count 1"))
    assert int(counted.right_after("pyrender", perturbation) or "-1") == int(counted.right) - 1


def test_a_colour_between_two_names_is_read_as_either() -> None:
    """A green cylinder of (53, 56, 44) was still nearer to green than to gray, and looked gray."""
    own = RECORD.objects[0].color
    perturbation = recoloured(0, min(set(RGB) - {own}, key=lambda one: dist(RGB[one], RGB[own])))
    perturbation["color"] *= 0.45
    asked = program("scene", f"filter_color 0 {own}", "count 1")
    assert question(asked).right_after("pyrender", perturbation) == question(asked).right  # its own name is the nearest
    assert not limits(asked).holds(perturbation)
    assert limits(COUNT).holds(perturbation)


def test_places_that_are_asked_about_keep_their_relations() -> None:
    pairs = [(k, j) for k in range(5) for j in RECORD.relationships["left"][k]]
    k, j = pairs[0]
    one = RECORD.objects[k]
    names = [f"filter_{name} {i} {one.value(name)}" for i, name in enumerate(("size", "color", "material", "shape"))]
    asked = program("scene", *names, "unique 4", "relate 5 left", "count 6")
    found = limits(asked)
    x, y, _ = RECORD.directions["right"]
    # object j is moved in small steps to the right: it may go on until it is no longer left of k, or hits something
    perturbation = nothing()
    perturbation["translation"][j] = 4 * torch.tensor([x, 0.0, -y])
    projected = found.project(perturbation)
    assert found.holds(projected)
    assert not found.holds(perturbation)
    assert question(asked).right_after("pyrender", projected) == question(asked).right


def test_random_perturbations_are_brought_to_scenes_that_exist() -> None:
    random = torch.Generator().manual_seed(0)
    asked = question(program("scene", "filter_shape 0 cube", "count 1"))
    found = limits_of([asked], initial())
    for size in (0.1, 0.5, 2.0):
        perturbation = {
            group: (size * torch.randn(value.shape, generator=random).double()).masked_fill(found.fixed[group], 0.0)
            for group, value in initial().items()
        }
        projected = found.project(perturbation)
        assert found.holds(projected)
        assert found.project(projected) is projected
        for group, change in projected.items():
            assert bool((change.abs() <= perturbation[group].abs() + 1e-12).all())


@pytest.mark.parametrize("renderer", ["torch", "image"])
def test_the_truth_stays_where_a_renderer_changes_no_scene(renderer: str) -> None:
    assert question(COUNT).right_after(renderer, {"normals": torch.ones(3)}) == "5"


def test_every_question_of_several_keeps_what_it_finds() -> None:
    own = RECORD.objects[0].color
    other = next(color for color in RGB if color not in {one.color for one in RECORD.objects})
    both = [question(COUNT), question(program("scene", f"filter_color 0 {own}", "count 1"))]
    found = limits_of(both, initial())
    assert not found.holds(recoloured(0, other))
    assert found.holds(found.project(recoloured(0, other)))


def unique_of(k: int) -> list[str]:
    """The functions that find object k alone by its attributes."""
    names = ("size", "color", "material", "shape")
    return ["scene", *(f"filter_{n} {i} {RECORD.objects[k].value(n)}" for i, n in enumerate(names)), "unique 4"]


def test_an_answer_that_stays_for_another_set_is_not_allowed() -> None:
    one, other = RECORD.objects[0].color, next(o.color for o in RECORD.objects if o.color != RECORD.objects[0].color)
    there = [k for k, o in enumerate(RECORD.objects) if o.color == other]
    asked = program("scene", f"filter_color 0 {one}", "exist 1")
    perturbation = recoloured(there[0], one)
    # there still is one, but the set has another object
    assert question(asked).right_after("pyrender", perturbation) == "yes"
    assert not limits(asked).holds(perturbation)


def test_a_question_that_would_be_ill_posed_is_not_allowed() -> None:
    asked = program(*unique_of(0), "query_shape 5")
    other = next(color for color in RGB if color not in {one.color for one in RECORD.objects})
    assert question(asked).right_after("pyrender", recoloured(0, other)) is None
    found = limits(asked)
    assert not found.holds(recoloured(0, other))
    assert question(asked).right_after("pyrender", found.project(recoloured(0, other))) == question(asked).right


def test_objects_that_would_meet_do_not() -> None:
    """Each moves halfway to the other, where they would meet."""
    perturbation = nothing()
    for k, j in ((0, 1), (1, 0)):
        perturbation["translation"][k] = towards(k, j, 0.5)["translation"][k]
    perturbation["color"][3] = 0.01
    found = limits(COUNT)
    assert not found.holds(perturbation)
    projected = found.project(perturbation)
    assert spheres_apart(projected, 0)
    assert spheres_apart(projected, 1)
    assert bool(projected["translation"][0].any())  # the first comes first
    assert torch.equal(projected["color"], perturbation["color"])


def test_a_camera_that_comes_too_near_is_brought_back() -> None:
    camera = SCENE.camera
    start = torch.tensor([camera.azimuth, camera.elevation, camera.distance, 0.0]).double()
    found = limits_of([question(COUNT)], initial() | {"camera": start})
    perturbation = nothing() | {"camera": torch.tensor([0.0, 0.0, -8.0, 0.0]).double()}
    assert not found.holds(perturbation)
    moved = found.project(perturbation)
    assert found.holds(moved)
    assert -8 < float(moved["camera"][2]) < 0


def test_an_object_is_not_hidden_behind_another() -> None:
    """Moved behind the large object 1, the small object 4 is seen in no pixel."""
    record = generate(21, 1, objects=(3, 5))
    hidden = {"translation": torch.zeros(len(record.objects), 3, dtype=torch.float64)}
    behind = torch.tensor(record.directions["behind"][:2])
    gap = RADIUS[record.objects[1].size] + RADIUS[record.objects[4].size] + 0.05
    place = torch.tensor(record.objects[1].coords_3d[:2]) + gap * behind
    x, y = (place - torch.tensor(record.objects[4].coords_3d[:2])).tolist()
    hidden["translation"][4] = torch.tensor([x, 0.0, -y])
    found = limits_of([question(COUNT, record)], nothing())
    assert not found.holds(hidden)
    shorter = found.project(hidden)
    assert found.holds(shorter)
    assert 0 < float(shorter["translation"].norm()) < float(hidden["translation"].norm())
