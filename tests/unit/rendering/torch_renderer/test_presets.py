import json
from importlib.resources import files
from math import pi

import numpy as np
import pytest
import torch

from services.errors import InvalidRequest
from services.rendering.torch_renderer.dsbrdf import SHAPE
from services.rendering.torch_renderer.presets import preset, presets
from tests.unit.rendering.shading import reference_brdf

NAMES = ["matte", "plastic", "glossy-paint", "brushed-metal"]


def ggx(n: np.ndarray, i: np.ndarray, o: np.ndarray, alpha: float, f0: float, albedo: float) -> float:
    """Lambertian under GGX with Smith's height-correlated shadowing, from vectors (Walter 2007, Heitz 2014)."""
    h = (i + o) / np.linalg.norm(i + o)
    fresnel = f0 + (1 - f0) * (1 - h @ i) ** 5
    tan2 = {name: 1 / (n @ v) ** 2 - 1 for name, v in (("h", h), ("i", i), ("o", o))}
    density = 1 / (pi * alpha**2 * (n @ h) ** 4 * (1 + tan2["h"] / alpha**2) ** 2)
    shadow = 1 / (1 + sum((np.sqrt(1 + alpha**2 * tan2[k]) - 1) / 2 for k in "io"))
    return albedo / pi * (1 - fresnel) + density * shadow * fresnel / (4 * (n @ i) * (n @ o))


SURFACES = {"plastic": (0.3, 0.04, 0.95), "glossy-paint": (0.12, 0.04, 0.95), "brushed-metal": (0.3, 0.92, 0.0)}


def test_names_and_shapes() -> None:
    assert list(presets()) == NAMES
    assert all(value.shape == SHAPE and value.isfinite().all() for value in presets().values())


def test_unknown_names_are_refused_with_the_nearest() -> None:
    with pytest.raises(InvalidRequest, match="glossy-paint") as refused:
        preset("glosy-paint", "scene.objects.3.material")
    assert refused.value.field == "scene.objects.3.material"
    with pytest.raises(InvalidRequest, match="matte, plastic, glossy-paint, brushed-metal"):
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
    """At θ_h = 0, the peak, where no angle is averaged away. 6 %: three times the worst weighted rms of the fits."""
    n, d = np.array([0.0, 0.0, 1.0]), np.radians(theta_d)
    i, o = np.array([np.sin(d), 0, np.cos(d)]), np.array([-np.sin(d), 0, np.cos(d)])
    found = reference_brdf(preset(name).numpy()[1], 0.0, d)
    assert found == pytest.approx(ggx(n, i, o, *SURFACES[name]), rel=0.06)


@pytest.mark.parametrize("name", NAMES)
def test_no_preset_makes_light(name: str) -> None:
    """Reflected share of light falling in at 0°, 30° and 60°: at most 1 (1 % for the fit)."""
    coefficients = preset(name).numpy()[0]
    for incidence in np.radians([0, 30, 60]):
        light = np.array([np.sin(incidence), 0, np.cos(incidence)])
        total = 0.0
        for mu in (np.arange(30) + 0.5) / 30:  # equal steps of cos² are equal projected solid angles
            for phi in (np.arange(40) + 0.5) * 2 * pi / 40:
                cosine = np.sqrt(mu)
                out = np.array([np.sqrt(1 - mu) * np.cos(phi), np.sqrt(1 - mu) * np.sin(phi), cosine])
                half = (light + out) / np.linalg.norm(light + out)
                rho = reference_brdf(coefficients, np.arccos(min(1, half[2])), np.arccos(min(1, half @ light)))
                total += rho * pi / (30 * 40)
        assert 0.3 < total < 1.01


def test_the_committed_file_says_how_it_was_made() -> None:
    committed = json.loads(files("services.rendering.torch_renderer").joinpath("presets.json").read_text())
    assert committed["command"].startswith("python scripts/fit_materials.py")
    assert {"numpy", "scipy", "torch", "python"} <= committed["versions"].keys()
    assert all(fit["rms_relative_error"] < 0.03 for fit in committed["presets"].values())


def test_a_preset_cannot_be_spoiled_by_its_user() -> None:
    before = preset("matte").clone()
    preset("matte").add_(1)
    assert torch.equal(preset("matte"), before)
