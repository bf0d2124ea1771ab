"""Mutants: lines of the product that are changed on purpose, and the test that each of them turns red.

A mutant whose line is gone, or that no test notices any more, fails here. Those that a case of the stability report
notices are in `tests/unit/accuracy/mutants.py`.
"""

import __future__

import inspect
import sys
import textwrap
from collections.abc import Callable
from pkgutil import resolve_name
from types import FunctionType
from typing import Any, NamedTuple

import pytest

from tests.unit.accuracy import test_attack_bounds
from tests.unit.analysis import test_adaptive
from tests.unit.attacks import test_p_rgf, test_samples, test_zoo
from tests.unit.rendering.torch import test_gradient_error, test_sampled_check, test_shadows


class Mutant(NamedTuple):
    """`line`, a part of the source of `function` that is there once, becomes `changed`; `test` then fails.

    `function` is "module:name".
    """

    function: str
    line: str
    changed: str
    test: Callable[[], None]


MUTANTS = {
    "partial visibility lost": Mutant(
        "scene_attack.rendering.torch.surfaces:regions",
        "(visibility < WHOLE)",
        "(visibility < WHOLE / 2)",
        test_shadows.test_a_matte_scene_in_partial_shadow_looks_the_same_from_near_and_from_afar,
    ),
    "mean of an image's errors": Mutant(
        "benchmarks.attack_bounds:_error",
        ".abs().max())",
        ".abs().mean())",
        test_attack_bounds.test_the_error_of_an_image_is_that_of_its_worst_value,
    ),
    "vanished signs counted as right": Mutant(
        "scene_attack.rendering.torch.planner:_compared",
        "& there\n",
        "& there & (value != 0)\n",
        test_gradient_error.test_a_gradient_that_vanishes_in_float32_has_the_wrong_sign,
    ),
    "roll drawn from elevation's number": Mutant(
        "scene_attack.attacks.problem:draw_variation",
        "radians(asked.roll) * around[2]",
        "radians(asked.roll) * around[1]",
        test_samples.test_the_numbers_of_a_variation_are_independent,
    ),
    "tables that are never checked": Mutant(
        "scene_attack.rendering.torch.shader:Shader.__call__",
        "if held:",
        "if True:",
        lambda: test_sampled_check.check(test_sampled_check.WALKS[0]),
    ),
    "half-steps measured at zero": Mutant(
        "scene_attack.attacks.differences:measure_half_steps",
        "(2 * signs - 1) * reach",
        "0 * signs * reach",
        test_zoo.test_half_steps_are_measured_away_from_the_start,
    ),
    "the adaptive attack without U": Mutant(
        "scene_attack.analysis.rerendering:attack_through",
        ".clamp(start - LIMIT, start + LIMIT)",
        "",
        test_adaptive.test_an_attack_of_many_steps_ends_at_the_limit,
    ),
    "prior of any length": Mutant(
        "scene_attack.attacks.p_rgf:PRGF.step",
        "(prior / prior.norm() * total**0.5)[None]",
        "prior[None]",
        test_p_rgf.test_the_priors_images_are_as_far_off_as_random_ones_and_along_the_gradient,
    ),
    "prior not in half-steps": Mutant(
        "scene_attack.attacks.p_rgf:PRGF.step",
        "at, step) * half_steps",
        "at, step)",
        test_p_rgf.test_the_priors_images_are_as_far_off_as_random_ones_and_along_the_gradient,
    ),
}


@pytest.mark.parametrize("mutant", MUTANTS.values(), ids=MUTANTS.keys())
def test_a_mutant_turns_its_test_red(mutant: Mutant, monkeypatch: pytest.MonkeyPatch) -> None:
    mutant.test()
    original = inspect.unwrap(resolve_name(mutant.function))
    monkeypatch.setattr(original, "__code__", changed(original, mutant).__code__)  # whoever has imported it sees it
    with pytest.raises(AssertionError):
        mutant.test()


def changed(original: Callable[..., Any], mutant: Mutant) -> FunctionType:
    """The function, compiled from its source with the line changed."""
    source = textwrap.dedent(inspect.getsource(original))
    assert source.count(mutant.line) == 1, f"{mutant.line!r} is {source.count(mutant.line)} times in {original}"
    code = compile(
        source.replace(mutant.line, mutant.changed),
        inspect.getfile(original),
        "exec",
        flags=__future__.annotations.compiler_flag,
        dont_inherit=True,
    )
    found: dict[str, Any] = {}
    exec(code, vars(sys.modules[original.__module__]), found)
    function = inspect.unwrap(found[original.__name__])
    assert isinstance(function, FunctionType)
    return function
