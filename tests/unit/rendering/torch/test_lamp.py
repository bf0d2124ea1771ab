"""The group `lamp`: a turned, dimmed and tinted map and a soft lamp, against scenes that are described so, Planck's
law, closed forms of the lobe, and differences."""

from math import cos, pi, radians, sinh

import numpy as np
import pytest
import torch
from torch import Tensor

import scene_attack as sa
from scene_attack.process import options
from scene_attack.rendering.physical_change import worded
from scene_attack.rendering.plan import Tolerance
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.rendering.torch.lamp import LOWEST, Lamp, Light, physical, white_point
from scene_attack.rendering.torch.light import Illumination, illumination
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import ResolvedScene, resolve
from tests.unit.rendering.shading import sky, sphere_scene, texels
from tests.unit.rendering.torch.planned import error, on_sphere
from tests.unit.rendering.torch.spheres import sphere

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def values(**numbers: float) -> Tensor:
    """Values [7] of the group, of the given numbers by the names of `Light`; the others are 0."""
    return torch.tensor([numbers.get(name, 0.0) for name in Light._fields], dtype=torch.float64)


def resolved(rotation: float = 0.4, size: tuple[int, int] = (8, 16)) -> ResolvedScene:
    """A ball under the studio's map, whose columns are finer than the texels and turned by part of one."""
    used = options()
    scene = {
        "camera": {"size": (32, 32)},
        "objects": [{"mesh": "primitive/sphere", "material": "plastic"}],
        "lights": {"environment": {"map": "studio", "size": size, "rotation": rotation}},
    }
    return resolve(sa.Scene.model_validate(scene), Library(used.cache_dir, used.data_dir))


def split(scene: ResolvedScene) -> Illumination:
    return illumination(torch.as_tensor(scene.environment))


def radiance(light: Illumination, added: Tensor | float = 0.0) -> np.ndarray:
    return np.asarray(light.chroma * (light.intensity[..., None] + added))


def lit(scene: ResolvedScene, of: Tensor) -> np.ndarray:
    """The radiance [rows, cols, 3] of the scene's map under values of the group, in the unit of intensities."""
    light = split(scene)
    return radiance(light, Lamp.of(scene, light).added(of, light.intensity))


def solid_angles(rows: int, cols: int) -> np.ndarray:
    return np.reshape([solid for *_, solid in texels(rows, cols)], (rows, cols))


# The turn


@pytest.mark.parametrize("degrees", [-30.0, -4.321, 11.25, 17.3])
def test_a_turned_map_is_that_of_the_scene_with_this_rotation(degrees: float) -> None:
    found = lit(resolved(), values(turn=degrees / 30))
    wanted = radiance(split(resolved(0.4 + radians(degrees))))
    # maps are averaged to float32: 6e-8 of the brightest texel of a row
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-6 * wanted.max())
    assert abs(found - radiance(split(resolved()))).max() > 0.01 * wanted.max()


@pytest.mark.parametrize("texel", [-1, 1])
def test_the_image_is_that_of_the_scene_with_this_rotation(texel: int) -> None:
    """By whole texels, so that the exposure, which is measured on a grid of surfaces, is the same."""
    turn = texel * 22.5
    renderer = TorchRenderer(resolved(), groups=("lamp",), tolerance="exact")
    found = renderer.render({"lamp": values(turn=turn / 30)[None]})
    described = TorchRenderer(resolved(0.4 + radians(turn)), groups=("lamp",), tolerance="exact").render({})
    torch.testing.assert_close(found, described, rtol=0, atol=1e-6)  # the map is float32
    assert float((found - renderer.render({})).abs().max()) > 0.05


def test_without_a_source_map_whole_texels_are_rolled() -> None:
    scene = sphere_scene(environment=sky(8, 16))
    own = radiance(split(scene))
    np.testing.assert_allclose(lit(scene, values(turn=-0.75)), np.roll(own, -1, axis=1), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("turn", [-0.9, 0.123, 1.0])
def test_a_turn_keeps_the_power_of_each_row(turn: float) -> None:
    scene = resolved()
    before, after = (lit(scene, values(turn=of)).sum(axis=1) for of in (0.0, turn))
    np.testing.assert_allclose(after, before, rtol=1e-12)


# The colour


def planck(temperature: float) -> np.ndarray:
    """Linear sRGB [3], of luminance 1, of a black body: Planck's law (c₂ = 0.014388 m K) by the fits of the CIE 1931
    colour matching functions of Wyman, Sloan and Shirley (JCGT 2(2), 2013, section 2.2)."""
    nm = np.arange(360.0, 831.0)

    def lobe(mean: float, below: float, above: float) -> np.ndarray:
        scaled: np.ndarray = (nm - mean) * np.where(nm < mean, below, above)
        return np.exp(-0.5 * scaled**2)

    x = 0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323) - 0.065 * lobe(501.1, 0.0490, 0.0382)
    y = 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725)
    spectrum = nm**-5 / np.expm1(0.014388e9 / (nm * temperature))
    xyz = np.array([of @ spectrum for of in (x, y, z)])
    return linear_srgb(xyz / xyz[1])


def linear_srgb(xyz: np.ndarray) -> np.ndarray:
    """From the chromaticities of the primaries and of D65, that sRGB is defined by."""
    primaries = np.array([[0.64, 0.33, 0.03], [0.30, 0.60, 0.10], [0.15, 0.06, 0.79]]).T
    white = np.array([0.3127, 0.3290, 0.3583]) / 0.3290
    return np.linalg.solve(primaries * np.linalg.solve(primaries, white), xyz)


@pytest.mark.parametrize("temperature", [2700.0, 3500.0, 5000.0, 6500.0])
def test_white_points_are_those_of_plancks_law(temperature: float) -> None:
    found = white_point(torch.tensor(temperature, dtype=torch.float64)).numpy()
    # the fits are off by about 1 % (measured: 1.1 %); a temperature off by 5 % moves blue by 4 to 16 %
    np.testing.assert_allclose(found, planck(temperature), rtol=0.02)


def test_the_white_point_of_incandescent_light_is_illuminant_a() -> None:
    """CIE 15 defines it as a black body of 2,855.5 K and gives its chromaticity, 0.44757 and 0.40745."""
    x, y = 0.44757, 0.40745
    found = white_point(torch.tensor(2855.5, dtype=torch.float64)).numpy()
    # the approximation is good to 1e-4 of a chromaticity, the matrix of sRGB to 1e-4 of its entries
    np.testing.assert_allclose(found, linear_srgb(np.array([x, y, 1 - x - y]) / y), atol=2e-3)


@pytest.mark.parametrize("temperature", [-1.0, -0.3, 0.8])
def test_a_tint_keeps_the_luminance_of_a_white_map(temperature: float) -> None:
    scene = sphere_scene(environment=np.ones((4, 8, 3), np.float32))
    before, after = (lit(scene, values(temperature=of)) for of in (0.0, temperature))
    np.testing.assert_allclose(after @ LUMINANCE, before @ LUMINANCE, rtol=1e-12)
    warm = after[..., 0] / after[..., 2]
    assert ((warm > 1.05) if temperature < 0 else (warm < 0.95)).all()


@pytest.mark.parametrize("brightness", [-1.0, 0.5])
def test_a_stop_halves_or_doubles_the_turned_map(brightness: float) -> None:
    scene = resolved()
    found, plain = (lit(scene, values(brightness=of, turn=0.4)) for of in (brightness, 0.0))
    np.testing.assert_allclose(found, 2**brightness * plain, rtol=1e-12)


# The lamp


def test_the_lamp_has_its_share_of_the_maps_power() -> None:
    scene = sphere_scene(environment=sky(8, 16))
    before, after = (lit(scene, values(power=power, radius=-0.5, azimuth=0.2)) for power in (0.0, 0.3))
    angles = solid_angles(8, 16)
    lamp = after - before
    total, more = ((of @ LUMINANCE * angles).sum() for of in (before, lamp))
    assert more == pytest.approx(0.3 * total, rel=1e-9)
    np.testing.assert_allclose(lamp[..., 0], lamp[..., 2], atol=1e-9 * lamp.max())  # it is white


@pytest.mark.parametrize("radius", [10.0, 20.0, 40.0])
def test_the_lobe_is_the_normal_distribution_of_the_sphere(radius: float) -> None:
    """κ / (4π sinh κ) · exp(κ cos), with half of its largest density at the radius."""
    scene = sphere_scene(environment=np.ones((64, 128, 3), np.float32))
    light = physical(values(radius=np.log2(radius / 20), azimuth=-0.25, elevation=0.2))
    assert float(light.radius) == pytest.approx(radius)
    found = Lamp.of(scene, split(scene)).lobe(light).numpy()
    kappa = np.log(2) / (1 - cos(radians(radius)))
    towards = np.reshape([direction for _, _, direction, _ in texels(64, 128)], (64, 128, 3))
    middle = np.array([0.0, np.sin(radians(54)), np.cos(radians(54))])  # azimuth 0: towards +z
    density = kappa / (4 * pi * sinh(kappa)) * np.exp(kappa * (towards @ middle))
    np.testing.assert_allclose(found, density, rtol=2e-3, atol=1e-9)  # a texel counts as its middle
    angle = np.degrees(np.arccos((towards @ middle).clip(-1, 1)))
    assert found[abs(angle - radius) < 0.5].mean() / found.max() == pytest.approx(0.5, rel=0.05)


def test_a_texel_without_a_colour_takes_none_of_it() -> None:
    """Its intensity is in units of its colour: no factor makes red light white."""
    environment = sky(4, 8)
    environment[1, :, 2] = 0
    scene = sphere_scene(environment=environment)
    before, after = (lit(scene, values(power=power, turn=power)) for power in (0.0, 1.0))
    np.testing.assert_array_equal(after[1, :, 2], 0.0)
    assert (after[1, :, 0] != before[1, :, 0]).all()


# Images and gradients


@pytest.mark.parametrize("tolerance", ["exact", 1e-3])
def test_no_change_leaves_the_same_bits(tolerance: Tolerance) -> None:
    renderer = TorchRenderer(resolved(size=(16, 32)), groups=("lamp",), tolerance=tolerance)
    start = renderer.initial()["lamp"]
    assert not start.any()
    assert torch.equal(renderer.render({"lamp": start[None]}), renderer.render({}))
    assert not torch.equal(renderer.render({"lamp": start[None] + 0.01}), renderer.render({}))


def test_gradient_against_central_differences() -> None:
    """By each number, at a turn within a column of the source map: its derivative jumps where columns meet."""
    renderer = TorchRenderer(resolved(), groups=("lamp",), tolerance="exact")
    weights = torch.randn(1, 32, 32, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    start = torch.tensor([[0.2031, -0.4, 0.3, 0.4, -0.1, 0.2, -0.3]], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad((renderer.render({"lamp": start}) * weights).sum(), start)
    h = 1e-5
    for k in range(7):
        step = torch.zeros_like(start)
        step[0, k] = h
        up, down = (
            float((renderer.render({"lamp": (start + sign * step).detach()}) * weights).sum()) for sign in (1, -1)
        )
        assert float(gradient[0, k]) == pytest.approx((up - down) / (2 * h), rel=1e-5), Light._fields[k]


def test_the_place_of_a_lamp_matters_once_it_has_power() -> None:
    renderer = sphere((16, 16), environment=sky(8, 16))
    for power in (0.0, 0.1):
        leaf = values(power=power)[None].requires_grad_()
        (gradient,) = torch.autograd.grad(renderer.render({"lamp": leaf}).sum(), leaf)
        assert (gradient[0, :4] != 0).all()
        assert (gradient[0, 4:] != 0).all() == (power > 0)
        assert gradient[0, 4:].any() == (power > 0)


@pytest.mark.parametrize("material", ["plastic", "brushed-metal", "metal"])
def test_planned_images_are_within_the_tolerance_at_the_ends_of_the_range(material: str) -> None:
    """A lamp as small as it may be is 91 times as bright as the map's mean, more than a plan allows of a texel."""
    renderer = on_sphere(("lamp",), materials=(material,))
    random = np.random.default_rng(0)
    for _ in range(8):
        ends = np.where(random.random(7) < 0.5, LOWEST, 1.0)
        ends[3], ends[6] = 1.0, -1.0
        parameters = {"lamp": torch.tensor(ends, dtype=torch.float32)[None]}
        assert error(renderer, parameters) <= 1e-3


def test_a_map_that_varies_is_changed_as_a_whole() -> None:
    """Under light of another intensity a turned map with a lamp is the same, times that intensity."""
    scene = resolved()
    light = split(scene)
    lamp, of = Lamp.of(scene, light), values(turn=0.4, temperature=0.5, power=0.2)
    plain, brighter = (lamp.added(of, factor * light.intensity) for factor in (1.0, 1.7))
    torch.testing.assert_close(brighter, 1.7 * plain, rtol=1e-10, atol=1e-10)


# Ranges, words and names


def test_the_bounds_are_the_declared_range() -> None:
    renderer = sphere()
    low, high = renderer.bounds()["lamp"]
    ends = [Light(*(round(float(number), 6) for number in physical(of.double()))) for of in (low, high)]
    assert ends == [Light(-30, 0.5, 2700, 0, -135, 0, 10), Light(30, 2, 6500, 1, 225, 90, 40)]
    declared = str(TORCH.group("lamp").natural_range)
    assert all(word in declared for word in ("30°", "a stop", "2,700 to 6,500 K", "10° to 40°"))
    assert renderer.names("lamp") == [name.replace("temperature", "colour temperature") for name in Light._fields]
    assert sa.FGSM(renderer="torch", groups=["lamp"]).truncation is None


def sentence(of: Tensor) -> str:
    [thing] = worded(sphere_scene(), sphere(), {"lamp": of})
    assert [image.file for image in thing.change.images] == ["map-before.png", "map-after.png", "map-ratio.png"]
    return thing.change.sentence


def test_sentences() -> None:
    everything = values(
        turn=0.4,
        brightness=np.log2(0.92),
        temperature=0.2663,
        power=0.2,
        azimuth=-5 / 180,
        elevation=10 / 45,
        radius=-0.42,
    )
    assert sentence(everything) == (
        "turned by +12°, 8 % dimmer, 4,287 K in place of 3,815 K, with a lamp of 20 % of the map's power at azimuth "
        "40°, elevation 55°, of 15° in radius"
    )
    assert "at azimuth −135°," in sentence(values(power=0.2, azimuth=1.0))
    assert sentence(values(turn=0.005, brightness=1.0, azimuth=1.0)) == "100 % brighter"
    assert sentence(values(turn=0.005)) == "changed by less than 1 % of what a room could have"


def test_numbers_before_and_after_and_the_share_of_the_range() -> None:
    [thing] = worded(sphere_scene(), sphere(), {"lamp": values(turn=-0.5, brightness=1.0)})
    found = [(value.name, value.before, value.after) for value in thing.change.values]
    assert found == [
        ("environment map, turn", 0, -15),
        ("environment map, brightness", 100, 200),
        ("environment map, colour temperature", pytest.approx(3815.2, abs=0.1), pytest.approx(3815.2, abs=0.1)),
        ("environment map, power of the lamp", 0, 0),
        ("environment map, share of the natural range", 0, 100),
    ]


def test_the_place_of_a_lamp_that_is_off_takes_no_share_of_the_range() -> None:
    [thing] = worded(sphere_scene(), sphere(), {"lamp": values(turn=-0.5, azimuth=1.0)})
    assert thing.sizes[-1].measure == "share of the natural range"
    assert thing.sizes[-1].value == pytest.approx(50)
