import json
from importlib.resources import files
from math import comb, pi

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.torch.dsbrdf import SHAPE, colored_lobes, preset, presets
from tests.unit.rendering.shading import reference_brdf

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
NAMES = ["matte", "plastic", "glossy-paint", "brushed-metal", "rubber", "metal"]


def surface(n_i: Array, n_o: Array, h_n: Array, h_i: Array, alpha: float, f0: float) -> Array:
    """GGX with Smith's height-correlated shadowing and Schlick's Fresnel term (Walter 2007, Heitz 2014), of cosines."""
    fresnel = f0 + (1 - f0) * (1 - h_i) ** 5
    tan2 = [1 / cosine**2 - 1 for cosine in (h_n, n_i, n_o)]
    density = 1 / (pi * alpha**2 * h_n**4 * (1 + tan2[0] / alpha**2) ** 2)
    shadow = 1 / (1 + sum((np.sqrt(1 + alpha**2 * t) - 1) / 2 for t in tan2[1:]))
    return density * shadow * fresnel / (4 * n_i * n_o)


def outgoing(incidence: float, rows: int = 400, columns: int = 200) -> tuple[Array, Array, Array, Array]:
    """A quadrature over the upper hemisphere for light at `incidence` radians: n·o, h·n, h·i and the projected solid
    angle of each direction o. Denser at grazing and towards the mirror direction, where gloss is narrow."""
    light = np.array([np.sin(incidence), 0, np.cos(incidence)])
    u = ((np.arange(rows) + 0.5) / rows)[:, None]
    n_o = u**2
    v = (np.arange(columns) + 0.5) / columns
    phi = pi * (1 - v**2)
    weight = n_o * 2 * u / rows * (2 * 2 * pi * v / columns)
    out = np.stack(np.broadcast_arrays(np.sqrt(1 - n_o**2) * np.cos(phi), np.sqrt(1 - n_o**2) * np.sin(phi), n_o), -1)
    half = (light + out) / np.linalg.norm(light + out, axis=-1, keepdims=True)
    return n_o, half[..., 2], half @ light, weight


SURFACES = {
    "plastic": (0.3, 0.04, 0.95),
    "glossy-paint": (0.12, 0.04, 0.95),
    "brushed-metal": (0.3, 0.92, 0.0),
    "rubber": (0.49, 0.04, 0.95),
    "metal": (0.16, 1.0, 0.0),
}


def test_names_and_shapes() -> None:
    assert list(presets()) == NAMES
    assert all(value.shape == SHAPE and value.isfinite().all() for value in presets().values())


def test_unknown_names_are_refused_with_the_nearest() -> None:
    with pytest.raises(InvalidRequest, match="glossy-paint") as refused:
        preset("glosy-paint", "scene.objects.3.material")
    assert refused.value.field == "scene.objects.3.material"
    with pytest.raises(InvalidRequest, match="matte, plastic, glossy-paint, brushed-metal, rubber, metal"):
        preset("xyzzy")


def test_matte_is_lambertian() -> None:
    """Within the 0.4 % that the committed fit reports as its largest error."""
    coefficients = preset("matte").numpy()[0]
    for theta_h in np.radians([0, 30, 60, 85]):
        for theta_d in np.radians([0, 40, 80]):
            assert reference_brdf(coefficients, theta_h, theta_d) == pytest.approx(1 / pi, rel=4e-3)


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("theta_d", [5.0, 35.0, 60.0])
def test_presets_are_the_surfaces_they_are_named_after(name: str, theta_d: float) -> None:
    """At θ_h = 0, the peak, where no angle is averaged away. 6 %: three times the worst weighted rms of the fits.

    The base reflects what the surface neither reflects on the way in nor out (Kelemen and Szirmay-Kalos 2001).
    """
    alpha, f0, albedo = SURFACES[name]
    cosine = np.cos(np.radians(theta_d))
    lets_in, of_all = 1 - share(np.radians(theta_d), alpha, f0), 1 - mean_share(alpha, f0)
    wanted = albedo / pi * lets_in**2 / of_all + surface(cosine, cosine, np.float64(1), cosine, alpha, f0)
    found = reference_brdf(preset(name).numpy()[1], 0.0, np.radians(theta_d))
    assert found == pytest.approx(wanted, rel=0.06)


@pytest.mark.parametrize("name", ["plastic", "glossy-paint", "rubber"])
@pytest.mark.parametrize("incidence", [0.0, 30.0, 60.0])
def test_colourless_lobes_reflect_what_the_surface_alone_does(name: str, incidence: float) -> None:
    """The share of light that the gloss reflects is that of the GGX surface, to a hundredth of the light: the lobes of
    a fit to the sum of body and gloss would be off by up to a tenth."""
    gloss = [lobe for lobe, colored in enumerate(colored_lobes(name)) if not colored]
    alpha, f0, _ = SURFACES[name]
    _, h_n, h_i, weight = outgoing(np.radians(incidence))
    theta_h, theta_d = np.arccos(np.minimum(h_n, 1)), np.arccos(np.minimum(h_i, 1))
    found = float((brdf(preset(name).numpy()[0][gloss], theta_h, theta_d) * weight).sum())
    assert found == pytest.approx(share(np.radians(incidence), alpha, f0), abs=0.01)


def share(incidence: float, alpha: float, f0: float) -> float:
    """The share of light that the surface alone reflects."""
    n_o, h_n, h_i, weight = outgoing(incidence)
    return float((surface(np.cos(incidence), n_o, h_n, h_i, alpha, f0) * weight).sum())


def mean_share(alpha: float, f0: float) -> float:
    """Its mean over directions of incidence, weighted by their cosine."""
    cosines = (np.arange(40) + 0.5) / 40
    return float(np.mean([2 * cosine * share(np.arccos(cosine), alpha, f0) for cosine in cosines]))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("incidence", [0, 20, 40, 60, 70, 75, 80, 83, 86, 88, 89, 89.9, 89.99])
def test_no_preset_makes_light(name: str, incidence: float) -> None:
    """A white furnace: the reflected share of light from one angle is at most 1, up to grazing. 2e-4 for the sum here,
    which sees a Lambertian surface of albedo 1 reflect 1.0000 and a lobe of its own at most that much wrong."""
    _, h_n, h_i, weight = outgoing(np.radians(incidence))
    theta_h, theta_d = np.arccos(np.minimum(h_n, 1)), np.arccos(np.minimum(h_i, 1))
    assert weight.sum() == pytest.approx(pi, rel=1e-4)
    total = float((brdf(preset(name).numpy()[0], theta_h, theta_d) * weight).sum())
    assert 0.3 < total < 1 + 2e-4


def brdf(coefficients: Array, theta_h: Array, theta_d: Array) -> Array:
    """The formula of docs/reports/materials.md for one channel's coefficients [3, 2, 6], exponents unbounded."""
    t = theta_d / (pi / 2)
    basis = np.stack([comb(5, i) * t**i * (1 - t) ** (5 - i) for i in range(6)], -1)
    values = 0.0
    for log_kappa, log_gamma in coefficients:
        values = values + np.expm1(np.exp(basis @ log_kappa) * np.cos(theta_h) ** np.exp(basis @ log_gamma))
    return values


def test_the_furnace_sees_a_preset_that_makes_light() -> None:
    """Glossy paint with a hundredth more of κ reflects more than it gets."""
    brighter = preset("glossy-paint").numpy()[0] + np.array([0.02, 0.0])[None, :, None]
    _, h_n, h_i, weight = outgoing(np.radians(82.0))
    theta_h, theta_d = np.arccos(np.minimum(h_n, 1)), np.arccos(np.minimum(h_i, 1))
    assert (brdf(brighter, theta_h, theta_d) * weight).sum() > 1.002


def test_the_committed_file_says_how_it_was_made() -> None:
    committed = json.loads(files("scene_attack.rendering.torch").joinpath("presets.json").read_text())
    assert committed["command"].startswith("python scripts/fit_materials.py")
    assert {"numpy", "scipy", "torch", "python"} <= committed["versions"].keys()
    assert all(fit["rms_relative_error"] < 0.03 for fit in committed["presets"].values())
    assert all(fit["largest_albedo"] <= 1 for fit in committed["presets"].values())


def test_a_preset_cannot_be_spoiled_by_its_user() -> None:
    before = preset("matte").clone()
    preset("matte").add_(1)
    assert torch.equal(preset("matte"), before)
