"""What the work-precision report claims of estimates of gradients; each claim fails where its method is broken."""

from math import sqrt

import pytest
import torch

from services.accuracy.placing import placed
from services.accuracy.work_precision.collect import estimates_of, objectives
from services.accuracy.work_precision.extent import QUICK
from services.accuracy.work_precision.gradients import GradientRow, Objective, along_directions, differences
from services.accuracy.work_precision.single_sample import Sampled
from services.rendering.compositing import over_ground
from services.rendering.factory import build
from services.rendering.pyrender_renderer.renderer import EXPOSURE

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def gradient_rows() -> list[GradientRow]:
    return [row for objective in objectives(QUICK) for row in estimates_of(objective, QUICK)]


def cubic(resolution: torch.dtype = torch.float64) -> Objective:
    """Σ x³ at three places: forward differences are off by 3x δ, central ones by δ²."""
    at = torch.tensor([0.5, -1.0, 2.0], dtype=torch.float64)
    return Objective(
        renderer="none",
        group="x",
        of="Σ x³",
        images=("float64",),
        at=at,
        coordinates=torch.arange(3),
        values=lambda points: (points.double() ** 3).sum(1, keepdim=True),
        gradient=3 * at**2,
        how="by hand",
        resolution=resolution,
    )


def error(of: list[GradientRow], **wanted: object) -> float:
    [row] = [row for row in of if all(getattr(row, key) == value for key, value in wanted.items())]
    return row.error


def test_forward_differences_are_of_first_order_and_central_of_second() -> None:
    found = list(differences(cubic()))
    length = float(cubic().gradient.norm())
    for delta in (1e-1, 1e-2, 1e-3):
        off = (3 * cubic().at * delta + delta**2).norm()
        assert error(found, estimator="forward", delta=delta) == pytest.approx(float(off) / length, rel=1e-4)
        assert error(found, estimator="central", delta=delta) == pytest.approx(sqrt(3) * delta**2 / length, rel=1e-3)
    assert {row.evaluations for row in found} == {4, 6}


def test_steps_that_a_number_cannot_take_divide_by_what_it_took() -> None:
    """float32 at 2 has steps of 2.4e-7: a quotient by δ = 1e-6 itself would be off by tenths."""
    found = list(differences(cubic(torch.float32), (1e-6, 1e-9)))
    assert error(found, estimator="central", delta=1e-6) < 1e-5
    assert error(found, estimator="central", delta=1e-9) == 1.0  # no step at all: difference 0


def test_random_directions_are_as_good_as_they_can_be() -> None:
    """√((n + 1) / c); the mean over 4,096 / c independent estimates is within a fifth of it."""
    found = list(along_directions(cubic(), (1, 8, 64, 4096)))
    for row in found[:3]:
        assert row.directions is not None
        assert row.error == pytest.approx(sqrt(4 / row.directions), rel=0.2)


def test_torch_differences_have_their_order(gradient_rows: list[GradientRow]) -> None:
    """With steps that are too small for a pixel to pass an edge of light, and large enough for float64."""
    own = [r for r in gradient_rows if (r.group, r.image, r.directions) == ("normals", "float64", None)]
    ratio = {
        estimator: error(own, estimator=estimator, delta=1e-4) / error(own, estimator=estimator, delta=1e-5)
        for estimator in ("central", "forward")
    }
    assert ratio["central"] == pytest.approx(100, rel=0.3)
    assert ratio["forward"] == pytest.approx(10, rel=0.1)


def test_central_differences_of_float_images_are_best_in_the_middle(gradient_rows: list[GradientRow]) -> None:
    """Curvature above, rounding below."""
    for group in ("normals", "light strength", "color", "light position"):
        own = [r for r in gradient_rows if (r.group, r.image, r.estimator) == (group, "float32", "central")]
        own = [row for row in own if row.samples in (None, 4)]
        errors = [row.error for row in own]
        best = errors.index(min(errors))
        assert 0 < best < len(errors) - 1
        assert errors[0] > 3 * errors[best]
        assert errors[-1] > 3 * errors[best]


@pytest.mark.parametrize("group", ["normals", "material", "light strength", "color", "light position"])
def test_eight_bits_are_useless_where_floats_are_good(gradient_rows: list[GradientRow], group: str) -> None:
    """At the paper's δ = 1e-4: an image's values move by less than a step of 1/255."""
    own = [r for r in gradient_rows if (r.group, r.estimator, r.delta) == (group, "central", 1e-4) and r.of[0] == "⟨"]
    by_image = {row.image: row for row in own if row.samples in (None, 4)}
    assert by_image["float32"].error < 0.05
    assert by_image["8 bit"].error > 0.5
    assert by_image["8 bit"].note


def test_poses_need_large_steps(gradient_rows: list[GradientRow]) -> None:
    """Silhouettes jump: at δ = 1e-4 the gradient is wrong even in float, at 1e-2 their error is a fraction."""
    for group in ("translation", "rotation"):
        own = [
            r for r in gradient_rows if (r.group, r.samples, r.image, r.estimator) == (group, 4, "float32", "central")
        ]
        assert error(own, delta=1e-2) < 0.4
        assert error(own, delta=1e-4) > 0.5


def test_images_of_any_number_of_samples_are_pyrenders() -> None:
    """With four they are the exact renderer's, to the bit; with one they differ at silhouettes, and there alone."""
    scene = placed("primitive/cube", size=(48, 48))
    exact = build(scene, "pyrender").exact()
    start = {group: value[None] for group, value in exact.initial().items()}
    ground = torch.tensor(scene.description.ground)
    images = [over_ground(Sampled(scene, samples).radiance(start), EXPOSURE, ground) for samples in (4, 1)]
    torch.testing.assert_close(images[0], exact.render(start), rtol=0, atol=1e-6)
    far = (images[1] - images[0]).abs().amax(-1) > 0.02
    assert 0 < far.double().mean() < 0.1
