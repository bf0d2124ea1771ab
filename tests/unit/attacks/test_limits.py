"""The limits of a request: which belong together, which groups they name, and what a method fills in."""

import pytest
from pydantic import ValidationError

from scene_attack.attacks.apgd import APGD
from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.mi_fgsm import MIFGSM
from scene_attack.attacks.square import Square
from scene_attack.attacks.zoo import ZOO
from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.runs.set_up import ATTACKS


@pytest.mark.parametrize(
    ("settings", "given", "message"),
    [
        (ZOO, {"constraint": "backtrack"}, "truncation: `backtrack` keeps"),
        (ZOO, {"perceptibility": 0.02}, 'perceptibility: only `"constraint": "backtrack"`'),
        (ZOO, {"constraint": "backtrack", "perceptibility": 2}, "less than or equal to 1.73"),
        (FGSM, {"constraint": "epsilon"}, "epsilon: group 'normals' has no value"),
        (FGSM, {"constraint": "epsilon", "truncation": 18}, "truncation: with the constraint `epsilon` there is no U"),
        (FGSM, {"restarts": 1}, "epsilon: group 'normals' has no value"),
        (FGSM, {"epsilon": {"image": 0.1}}, "epsilon: 'image' is not an attacked group"),
        (FGSM, {"bounds": {"image": [0, 1]}}, "bounds: 'image' is not an attacked group"),
        (FGSM, {"bounds": {"normals": [1, 1]}}, "bounds: those of group 'normals' are 1 and 1"),
        (FGSM, {"epsilon": {"normals": 0}}, "greater than 0"),
        (Square, {"renderer": "torch", "groups": ["material"]}, "groups: 'material' is no image"),
        (APGD, {"masking_queries": 10}, "masking_queries: 'illumination' is no image"),
        (APGD, {"loss": "hinge"}, "'log-odds', 'margin' or 'dlr'"),
    ],
)
def test_limits_that_do_not_agree_are_refused(settings: type[FGSM], given: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError) as error:
        settings.model_validate(given)
    assert message in str(error.value)


def test_only_the_limit_that_the_constraint_has_is_in_force() -> None:
    limits = {"normals": 0.1, "illumination": 1.0, "material": 2.0}
    settings = MIFGSM.model_validate({"constraint": "epsilon", "epsilon": limits})
    assert (settings.truncation, settings.epsilon) == (None, limits)
    assert MIFGSM.model_validate({"constraint": "backtrack"}).truncation == 18
    assert MIFGSM().constraint == "truncate"
    with_p = {"renderer": "pyrender", "constraint": "backtrack", "perceptibility": 0.02}
    assert MIFGSM.model_validate(with_p).truncation is None
    assert MIFGSM.model_validate(with_p | {"truncation": 18}).truncation == 18
    assert MIFGSM.model_validate(with_p | {"perceptibility": None}).truncation == 18
    assert MIFGSM().epsilon == {}


def test_methods_that_need_a_limit_take_the_one_that_the_renderer_suggests() -> None:
    suggested = APGD()
    assert set(suggested.epsilon) == {"normals", "illumination", "material"}
    chosen = APGD.model_validate({"epsilon": {"normals": 0.01}}).epsilon
    assert chosen == suggested.epsilon | {"normals": 0.01}
    assert Square().renderer == "image"
    assert Square().base_renderer == "torch"
    assert Square().epsilon == {"image": 8 / 255}


BLIND: dict[str, dict[str, float]] = {
    "cma-es": {"spread": 20},
    "spsa": {"delta": 3.75, "learning_rate": 3.75},
    "p-rgf": {"delta": 3.75, "learning_rate": 15},
}


@pytest.mark.parametrize("name", BLIND)
@pytest.mark.parametrize("limit", [{"constraint": "backtrack", "perceptibility": 0.05}, {"truncation": 18}])
def test_a_search_that_p_or_u_limits_has_no_epsilon_that_nobody_asked_for(name: str, limit: dict[str, object]) -> None:
    """Its steps are then those that the renderer suggests, times a factor, and no shorter than with the suggested ε."""
    for declaration in (PYRENDER, TORCH):
        settings = ATTACKS[name].model_validate({"renderer": declaration.name} | limit)
        assert settings.epsilon == {}
        for field, factor in BLIND[name].items():
            suggested = {
                group.name: factor * max(group.suggested_step or 0, (group.suggested_limit or 0) / 60)
                for group in declaration.groups
                if group.by_default
            }
            assert getattr(settings, field) == pytest.approx(suggested, rel=1e-12)
    given = ATTACKS[name].model_validate({"renderer": "pyrender", "epsilon": {"color": 0.3}} | limit)
    assert given.epsilon == {"color": 0.3}


@pytest.mark.parametrize("name", BLIND)
def test_a_search_without_another_limit_takes_the_suggested_epsilon(name: str) -> None:
    settings = ATTACKS[name].model_validate({"renderer": "pyrender"})
    assert settings.epsilon == {"illumination": 0.1, "color": 0.1, "translation": 0.02, "rotation": 0.1}
    assert ATTACKS[name].model_validate(settings.model_dump()) == settings


def test_apgd_measures_its_step_in_an_epsilon_whatever_else_limits_it() -> None:
    settings = APGD.model_validate({"renderer": "pyrender", "constraint": "backtrack", "perceptibility": 0.05})
    assert settings.epsilon["illumination"] == 0.1
