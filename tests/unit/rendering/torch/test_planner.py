"""The method that a plan chooses, the groups it serves, and its determinism."""

import pytest
import torch

from scene_attack.rendering.plan import Plan
from tests.unit.rendering.torch.planned import GROUPS, moved, on_sphere


def test_exact_takes_no_shortcut() -> None:
    renderer = on_sphere(tolerance="exact")
    assert renderer.exact() is renderer
    assert renderer.plan.error == 0
    assert renderer.initial()["material"].dtype == torch.float64
    assert all(
        s.recipe.rows is None and s.recipe.varying.all() and len(s.recipe.active_texels) == 512
        for s in renderer.shaders
    )


def test_the_attacked_groups_decide_the_method() -> None:
    kinds = {
        groups: on_sphere(groups, size=96).shaders[0].recipe
        for groups in (("normals",), ("illumination",), ("illumination_rgb",), GROUPS)
    }
    assert kinds["normals",].method == "cached_table"
    assert kinds["illumination",].method == "precomputed_transport"
    assert kinds["illumination_rgb",].method == "precomputed_transport"
    assert kinds[GROUPS].method == "summed"
    assert kinds["normals",].gray
    assert not kinds[GROUPS].gray


def test_an_exact_renderer_renders_every_group_whatever_is_attacked() -> None:
    """The verifier always renders the whole set of parameters."""
    renderer = on_sphere(("normals",), "exact", size=12)
    start = {group: value[None] for group, value in renderer.initial().items()}
    assert torch.equal(renderer.exact().render(start), on_sphere(tolerance="exact", size=12).render(start))


def test_a_group_that_is_not_attacked_cannot_be_rendered() -> None:
    renderer = on_sphere(("normals",))
    with pytest.raises(ValueError, match="illumination"):
        renderer.render({"illumination": renderer.initial()["illumination"][None] * 2})


def test_plans_are_deterministic() -> None:
    one, other = on_sphere(size=48), on_sphere(size=48)
    assert one.plan == other.plan
    assert Plan.model_validate_json(one.plan.model_dump_json()) == one.plan
    parameters = moved(one, GROUPS)
    assert torch.equal(one.render(parameters), other.render(parameters))


def test_a_table_filled_in_two_steps_is_the_same_table() -> None:
    """A resumed job meets its normals in another order. Its images are bit-identical."""
    straight, detour = on_sphere(("normals",), size=96), on_sphere(("normals",), size=96)
    assert straight.shaders[0].recipe.method == "cached_table"
    far, farther = moved(straight, ("normals",), 1.0), moved(straight, ("normals",), 4.0)
    detour.render(far)
    assert torch.equal(straight.render(farther), detour.render(farther))
