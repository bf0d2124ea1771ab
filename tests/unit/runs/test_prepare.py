"""Every request that cannot run is refused before it is queued, and the refusal names the field."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.runs.prepare import plan, prepare
from scene_attack.runs.spec import parse
from scene_attack.targets import registry
from scene_attack.targets.info import TargetInfo
from scene_attack_accuracy.stability.objects import linear_network
from tests.unit.jobs.small import LIBRARY, SPHERE, spec

pytestmark = pytest.mark.slow

LINEAR = {"name": "linear"}
SOMEWHERE_ELSE = {"mesh": "primitive/sphere", "translation": [50, 0, 0]}

HIDDEN = {"objects": [{"mesh": "primitive/sphere", "scale": 0.3}], "floor": {"height": 0.4}}

REFUSED: list[tuple[str, dict[str, Any]]] = [
    ("scene.objects.0.mesh", {"scene": {"objects": [{"mesh": "furniture/no-such-thing"}]}}),
    ("scene.objects.0.mesh", {"scene": {"objects": [{"mesh": "sha256:" + "0" * 64}]}}),
    ("scene.objects.0.mesh", {"scene": {"objects": [{"mesh": "../../etc/passwd"}]}}),
    ("scene.objects.0.material", {"scene": {"objects": [{"mesh": "primitive/sphere", "material": "gold"}]}}),
    ("scene.lights.environment.map", {"scene": SPHERE | {"lights": {"environment": {"map": "moon"}}}}),
    ("scene.objects.0", {"scene": {"objects": [SOMEWHERE_ELSE]}}),
    ("scene.objects.0.metallic", {"scene": {"objects": [{"mesh": "primitive/sphere", "metallic": 2}]}}),
    ("scene.floor.roughness", {"scene": SPHERE | {"floor": {"roughness": -1}}}),
    ("scene.floor.material", {"scene": SPHERE | {"floor": {"height": -0.7, "material": "marble"}}}),
    ("scene.floor", {"scene": SPHERE | {"floor": {"height": 90, "size": 1}}}),
    ("scene.objects", {"scene": HIDDEN}),
    ("target.name", {"target": {"name": "alexnet"}}),
    ("target.ask", {"target": {"name": "efficientnet-lite0", "ask": {"question": "how many?"}}}),
    ("goal.leave", {"goal": {"leave": "grand piano"}}),  # the network says something else of a sphere
    ("goal.leave", {"goal": {"leave": "gran piano"}}),
    ("goal.leave", {"goal": {"leave": 1000}}),
    ("goal.truth", {"goal": {"truth": "gran piano"}}),
    ("goal.truth.1", {"goal": {"truth": ["grand piano", 1000]}}),
    ("goal.leave", {"goal": {"leave": []}}),
    ("goal.least_confidence", {"goal": {"least_confidence": 1}}),
    ("goal.least_confidence", {"goal": {"least_confidence": float("nan")}}),
    ("goal.reach", {"goal": {"reach": 1000}}),
    ("goal.reach", {"goal": {"reach": 3, "leave": 3}}),
    ("attack.groups", {"attack": {"renderer": "torch", "groups": ["color"]}}),
    ("attack.renderer", {"attack": {"renderer": "povray"}}),
    ("attack.steps", {"attack": {"steps": 0}}),
    ("attack.steps", {"attack": {"steps": 10**9}}),
    ("attack.queries", {"attack": {"queries": 0}}),
    ("attack.learning_rate", {"attack": {"learning_rate": {"color": 1.0}}}),
    ("attack.learning_rate.normals", {"attack": {"learning_rate": {"normals": float("nan")}}}),
    ("attack.bounds.image", {"attack": {"renderer": "image", "bounds": {"image": [0.99, 1.0]}}}),
    ("attack.bounds.image", {"attack": {"renderer": "image", "bounds": {"image": [0.0, 255.0]}}}),
    ("attack.epsilon.bump", {"attack": {"renderer": "torch", "groups": ["bump"], "epsilon": {"bump": 50}}}),
    ("attack.epsilon", {"attack": {"renderer": "image", "restarts": 2}}),
    ("attack.epsilon.image", {"attack": {"renderer": "image", "epsilon": {"image": -0.1}}}),
    ("attack.truncation", {"attack": {"renderer": "image", "constraint": "backtrack", "truncation": None}}),
    ("attack.groups", {"attack": {"method": "square", "renderer": "torch", "groups": ["material"]}}),
    ("attack.loss", {"attack": {"method": "apgd", "loss": "hinge"}}),
    ("attack.expectation", {"attack": {"expectation": {}}}),
    ("attack.expectation.azimuth", {"attack": {"renderer": "torch", "expectation": {"azimuth": 5}}}),
    ("attack.expectation.intensity", {"attack": {"renderer": "image", "expectation": {"intensity": 0.1}}}),
    ("attack.expectation.elevation", {"attack": {"renderer": "pyrender", "expectation": {"elevation": 120}}}),
    ("attack.expectation.distance", {"attack": {"renderer": "pyrender", "expectation": {"distance": 0.9}}}),
    ("attack.expectation.sensor.iso", {"attack": {"expectation": {"sensor": {"iso": -1}}}}),
    ("attack.expectation.samples", {"attack": {"expectation": {"sensor": {}, "samples": 65}}}),
    ("attack.truncation", {"attack": {"expectation": {"sensor": {}}, "truncation": 18}}),
    ("attack.truncation", {"attack": {"expectation": {"sensor": {}}, "truncation": 18, "constraint": "backtrack"}}),
    ("attack.pairs", {"attack": {"method": "p-rgf", "pairs": 0}}),
    ("attack.base_renderer", {"attack": {"renderer": "torch", "base_renderer": "pyrender"}}),
    ("scene.camera.size.0", {"scene": SPHERE | {"camera": {"size": [4096, 64]}}}),
    ("scene.camera.distance", {"scene": SPHERE | {"camera": {"distance": float("inf")}}}),
    ("scene.ground.1", {"scene": SPHERE | {"ground": [0, float("nan"), 0]}}),
    ("scene.objects", {"scene": {"objects": []}}),
    ("scene.lights.points", {"scene": SPHERE | {"lights": {"points": [{}] * 5}}}),
    ("seed", {"seed": -1}),
    ("colour", {"colour": "blue"}),
]


@pytest.mark.parametrize(("field", "changes"), REFUSED, ids=lambda value: value if isinstance(value, str) else "")
def test_refused_naming_the_field(field: str, changes: dict[str, Any]) -> None:
    with pytest.raises(InvalidRequest) as refused:
        prepare(parse({"scene": SPHERE} | changes), LIBRARY)
    assert refused.value.field == field
    assert len(refused.value.detail) > 10


def test_an_unknown_label_comes_with_near_ones() -> None:
    with pytest.raises(InvalidRequest, match="did you mean 'grand piano'"):
        prepare(spec(goal={"leave": "gran piano"}), LIBRARY)


def test_a_scene_it_gets_wrong_says_what_the_network_says() -> None:
    first = prepare(spec(), LIBRARY).spec.goal.leave
    with pytest.raises(InvalidRequest, match=f"already gets this scene wrong: it says '{first}'"):
        prepare(spec(goal={"leave": "grand piano"}), LIBRARY)


def test_the_first_answer_is_the_label_to_leave_by_default() -> None:
    prepared = prepare(spec(), LIBRARY)
    first = int(prepared.original.logits.argmax())
    assert prepared.settled.goal.leave == (first,)
    assert prepared.spec.goal.leave == prepared.target.labels[first]
    assert prepared.settled.truth == prepared.spec.goal.truth == ()
    # saying it outright, by name or index, is the same request, but for the truth that it states
    for label in (first, prepared.target.labels[first]):
        stated = prepare(spec(goal={"leave": label}), LIBRARY)
        assert (stated.settled.goal, stated.settled.truth) == (prepared.settled.goal, (first,))
        assert stated.spec.goal.leave == prepared.spec.goal.leave


def test_a_scene_that_is_wrong_by_its_truth_is_attacked_with_a_warning() -> None:
    found = prepare(spec(goal={"truth": "grand piano"}), LIBRARY)
    assert "already-wrong" in [warning.code for warning in found.settled.warnings]
    assert found.spec.goal.truth == ("grand piano",)
    assert found.spec.goal.leave not in (None, "grand piano")


def test_the_truth_of_a_library_mesh_is_filled_in() -> None:
    scene = {"objects": [{"mesh": "furniture/soccer-ball"}], "camera": {"size": [96, 96]}}
    found = prepare(parse({"scene": scene}), LIBRARY)
    assert found.spec.goal.truth == ("soccer ball",)
    assert found.spec.goal.leave == "soccer ball"
    assert found.settled.warnings == ()


def test_a_goal_already_reached_is_refused() -> None:
    first = prepare(spec(), LIBRARY).spec.goal.leave
    with pytest.raises(InvalidRequest, match="already says") as refused:
        prepare(spec(goal={"reach": first}), LIBRARY)
    assert refused.value.field == "goal.reach"


def known(classes: int, differentiable: bool | None = None) -> AbstractContextManager[None]:
    """A network with linear scores, which requests can name as LINEAR for as long as the context lasts."""
    card = TargetInfo(
        name=LINEAR["name"],
        title="sums of pixels",
        task="classification",
        input_size=(8, 8),
        classes=classes,
        differentiable=differentiable,
        source="this test",
        licence="none",
    )
    return registry.registered(card, linear_network(classes=classes))


def test_a_network_with_one_label_is_refused_beforehand() -> None:
    with known(classes=1), pytest.raises(InvalidRequest, match="one label only") as refused:
        prepare(spec(target=LINEAR), LIBRARY)
    assert refused.value.field == "target.name"


def test_a_method_that_needs_gradients_of_a_network_without_is_refused() -> None:
    """It was queued, and failed in the job."""
    image = {"renderer": "image", "base_renderer": "pyrender"}
    said = r"have none with respect to the image .* methods without gradients are cma-es, p-rgf, spsa, square, zoo"
    with known(classes=4, differentiable=False):
        with pytest.raises(InvalidRequest, match=said) as refused:
            prepare(spec(image | {"method": "fgsm"}, target=LINEAR), LIBRARY)
        assert refused.value.field == "attack.method"
        assert prepare(spec(image | {"method": "zoo"}, target=LINEAR), LIBRARY).spec.attack.method == "zoo"


def test_a_loss_that_the_number_of_classes_rules_out_is_refused() -> None:
    attack = {"renderer": "image", "method": "apgd", "loss": "dlr"}
    with known(classes=2):
        with pytest.raises(InvalidRequest, match="dlr needs at least 3 classes") as refused:
            prepare(spec(attack=attack, target=LINEAR), LIBRARY)
        assert refused.value.field == "attack.loss"
        assert prepare(spec(attack=attack | {"loss": "margin"}, target=LINEAR), LIBRARY)


# The environment map's size


def auto(tolerance: float, **attack: Any) -> dict[str, Any]:
    """A job that leaves the size of the map to the planner."""
    lights = {"environment": {"map": "studio", "size": "auto"}}
    return {"scene": SPHERE | {"lights": lights}, "tolerance": tolerance} | ({"attack": attack} if attack else {})


def test_the_smallest_map_within_the_tolerance_is_chosen_and_said() -> None:
    chosen = [prepare(parse(auto(t)), LIBRARY).spec.scene.lights.environment.size for t in (0.1, 0.01)]
    assert chosen[0] < chosen[1]
    for tolerance, size in zip((0.1, 0.01), chosen, strict=True):
        scene = SPHERE | {"lights": {"environment": {"map": "studio", "size": size}}}
        error = plan(parse({"scene": scene, "tolerance": tolerance}), LIBRARY).environment_map_error
        assert error is not None
        assert error <= tolerance


def test_where_no_map_lights_the_scene_its_size_is_the_default() -> None:
    spec = prepare(parse(auto(1e-3, renderer="pyrender")), LIBRARY).spec
    assert spec.scene.lights.environment.size == (16, 32)


def test_a_target_of_the_analysis_that_cannot_be_loaded_is_refused_before_the_attack(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def load(name: str) -> object:
        raise InvalidRequest("target.name", f"target {name!r} cannot be loaded")

    monkeypatch.setattr("scene_attack.runs.prepare.registry.load", load_but(load, "alexnet"))
    with pytest.raises(InvalidRequest, match="'alexnet' cannot be loaded") as refused:
        prepare(spec(analysis={"transfer": {"targets": ["efficientnet-lite0", "alexnet"]}}), LIBRARY)
    assert refused.value.field == "analysis.transfer.targets.1"


def load_but(failing: Callable[[str], object], name: str) -> Callable[[str], object]:
    """The registry's function to load a target, except of one name."""
    real = registry.load
    return lambda one: failing(one) if one == name else real(one)
