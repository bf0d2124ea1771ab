"""Environment maps: suns, darkness, damage, one texel and eight million."""

from math import pi

import numpy as np
import torch

from services.accuracy.placing import TABLES, placed, sky
from services.accuracy.stability import definition
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.lobes import of_one_lobe
from services.accuracy.stability.shading import EXACT, LOOP, Shading
from services.rendering.torch_renderer.environment_light import illumination
from services.scenes.environment import average, from_picture, radiance_of
from services.scenes.mesh import Doubles, Floats


def sun(radiance: float, around: float, rows: int = 16, cols: int = 32) -> Floats:
    """One texel of `radiance`, above and to the right of the default camera, in a sky of `around`."""
    sun = np.full((rows, cols, 3), around, np.float32)
    sun[rows // 4, cols // 4] = radiance
    return sun


def _picture(map_: Floats, kappa: float = 0.3, gamma: float = 1.0, clipped: bool = False) -> Measured:
    found = Shading.of(placed(radiance=map_, size=TABLES)).errors({"material": of_one_lobe(kappa, gamma)})
    need(found.exact <= EXACT, f"the judge's picture is off by {found.exact:.1e}")
    need(not clipped or found.clipped > 0, "nothing is beyond white by the definition")
    return Measured(found.loop, LOOP, "largest error of a displayed value, against the definition in float64")


def _dark() -> Measured:
    """No light at all: the object is black, and light can still be attacked."""
    shading = Shading.of(placed(radiance=np.zeros((8, 16, 3), np.float32)))
    with torch.no_grad():
        picture = shading.renderer.render({})[0]
    full = shading.gbuffer.coverage == 1
    need(bool(full.any()), "no pixel is fully covered")
    light = shading.renderer.initial()["illumination"]
    need(bool((light == 0).all()), "a dark map has light")
    slope, _ = shading.gradient({"illumination": light + 1e-3}, "illumination")
    need(float(slope.abs().max()) > 0, "light cannot be attacked")
    return Measured(float(picture[full].abs().max()), 0.0, "brightest displayed value; black is 0")


def _constant() -> Measured:
    """A nearly Lambertian white sphere in even light is even: 0.9 wherever it is looked at (closed form)."""
    shading = Shading.of(placed(radiance=np.full((64, 128, 3), 3.0, np.float32)))
    # exp(κ) − 1 = 1/π, and γ = 1e-3 takes less than 1 % of it.
    parameters = {"material": of_one_lobe(float(np.log1p(1 / pi)), 1e-3)}
    with torch.no_grad():
        picture = shading.renderer.render({g: v[None] for g, v in parameters.items()})[0]
    seen = picture[shading.gbuffer.coverage == 1].double().numpy()
    wanted = float(definition.displayed(np.array([0.9]))[0])
    return Measured(float(np.abs(seen - wanted).max()), 0.01, "distance from the displayed value of 0.9, closed form")


def _scale(factor: float) -> Measured:
    """The exposure undoes a map's scale."""
    plain, scaled = illumination(torch.tensor(sky())), illumination(torch.tensor(sky().astype(np.float64) * factor))
    need(bool(torch.isfinite(scaled.chroma).all()), "a chroma is not finite")
    both = [map_.exposure * map_.chroma * map_.intensity[..., None] for map_ in (plain, scaled)]
    error = float(((both[0] - both[1]).abs() / both[0].abs().max()).max())
    return Measured(error, 1e-6, "change of the shown radiance, relative to its largest, when the map is scaled")


def _cleaned(texel: float) -> Measured:
    """What a file's pixels become."""
    picture = sky(16, 32)
    picture[3, 5] = texel
    clean = radiance_of(picture)
    need(bool(np.isfinite(clean).all()), "it has texels that are not finite")
    wanted = picture.copy()
    wanted[3, 5] = 0
    need(bool((clean >= 0).all()), "it has negative texels")
    return Measured(float(np.abs(clean - from_picture(wanted)).max()), 0.0, "change of any other texel; this one is 0")


def _large(height: int, width: int) -> Measured:
    """A large map with a sun of 1e6 in one texel, averaged down to 16×32."""
    random = np.random.default_rng(3)
    large = random.random((height, width, 3), dtype=np.float32)
    large[height // 3, width // 5] = 1e6
    seen = average(large, 16, 32).astype(np.float64)
    need(bool(np.isfinite(seen).all()), "a texel is not finite")
    error = np.abs(seen - _block_means(large, 16, 32)) / seen
    return Measured(
        float(error.max()), 1e-6, "relative error of a texel, against means by solid angle written as loops"
    )


def _block_means(large: Floats, rows: int, cols: int) -> Doubles:
    """Means over whole blocks, each row by its solid angle; for sizes that divide."""
    height, width = large.shape[0] // rows, large.shape[1] // cols
    weight = np.sin((np.arange(large.shape[0]) + 0.5) * pi / large.shape[0])
    out = np.empty((rows, cols, 3))
    for i in range(rows):
        band, w = large[i * height : (i + 1) * height].astype(np.float64), weight[i * height : (i + 1) * height]
        for j in range(cols):
            out[i, j] = w @ band[:, j * width : (j + 1) * width].mean(axis=1) / w.sum()
    return out


def _one_texel_spread() -> Measured:
    """A map of one texel is the same from everywhere, at any size and turn."""
    spread = average(np.full((1, 1, 3), 0.7, np.float32), 64, 128, 1.234)
    return Measured(float(np.abs(spread - np.float32(0.7)).max()), 1e-7, "distance from the one texel's radiance")


def _turned(rotation: float) -> Measured:
    """Whatever the turn, the light of the whole sphere stays the same."""
    source, turned = sky(16, 32), average(sky(16, 32), 5, 7, rotation)
    totals = [
        (map_.reshape(-1, 3).astype(np.float64) * definition.texels(*map_.shape[:2])[1][:, None]).sum(axis=0)
        for map_ in (source, turned)
    ]
    return Measured(float(np.abs(totals[1] / totals[0] - 1).max()), 1e-6, "relative change of the light of the sphere")


def _one_texel() -> Measured:
    """A map of one texel is one direction, −z, for the renderer: the shading that is defined so."""
    shading = Shading.of(placed(radiance=np.ones((1, 1, 3), np.float32), camera={"azimuth": 2.0}))
    found = shading.errors({"material": of_one_lobe(0.3, 1.0)})
    need(found.exact <= EXACT, f"the judge's picture is off by {found.exact:.1e}")
    return Measured(found.loop, LOOP, "largest error of a displayed value, against the definition in float64")


def _opposite() -> Measured:
    """All light from straight behind the object, and normals turned to it: the half vector has no direction."""
    scene = placed(radiance=np.ones((1, 1, 3), np.float32), camera={"azimuth": 0.0, "elevation": 0.0})
    shading = Shading.of(scene)
    need(bool(np.allclose(definition.texels(1, 1)[0][0], -scene.view[:3, 2])), "the light is not opposite the viewer")
    turned = torch.tensor([pi - 0.1, pi / 2 + 0.1]).expand(*shading.renderer.size, 2).contiguous()
    parameters = {"material": of_one_lobe(0.02, 0.01), "normals": turned}
    found = shading.errors(parameters)
    slope, _ = shading.gradient(parameters, "normals")
    need(float(slope.abs().max()) > 0, "no normal has a slope")
    need(found.exact <= EXACT, f"the judge's picture is off by {found.exact:.1e}")
    return Measured(found.loop, LOOP, "largest error of a displayed value, against the definition in float64")


def cases() -> list[Case]:
    """The cases of this family."""
    family, same = "environments", "the loop's picture has the tolerance, the judge's is exact"
    inf, nan, refused = float("inf"), float("nan"), "a clear error names the map"
    return [
        Case("sun of 1e6 in a sky of 1", family, "one texel of 512", same, lambda: _picture(sun(1e6, 1))),
        Case("sun of 1e6 in darkness", family, "one lit texel", same, lambda: _picture(sun(1e6, 0))),
        Case(
            "sun of 1e6 on a mirror",
            family,
            "κ 100, γ 1e4 under one texel",
            same,
            lambda: _picture(sun(1e6, 0), 100, 1e4, True),
            "clipped",
        ),
        Case(
            "a smaller sun of 1e6",
            family,
            "a 32×64 map, one texel of 1e6",
            same,
            lambda: _picture(sun(1e6, 1, 32, 64), 1, 50),
        ),
        Case("all-zero map", family, "no light, no scale", "black, finite, still attackable", _dark),
        Case("constant map", family, "no contrast", "an even picture of 0.9", _constant),
        Case("map × 1e30", family, "squares beyond float32", "the scale is undone", lambda: _scale(1e30)),
        Case("map × 1e-300", family, "squares below float64", "the scale is undone", lambda: _scale(1e-300)),
        Case("1×1 map", family, "one direction", same, _one_texel),
        Case("light opposite the viewer", family, "a half vector without direction", same, _opposite),
        Case("+inf texel", family, "light without end", refused, lambda: _cleaned(inf), "refused", "environment"),
        Case("−inf texel", family, "less than nothing", refused, lambda: _cleaned(-inf), "refused", "environment"),
        Case("NaN texel", family, "not a number", refused, lambda: _cleaned(nan), "refused", "environment"),
        Case(
            "negative texel",
            family,
            "ringing of a filter",
            "held at 0, all else stays",
            lambda: _cleaned(-3.0),
            "clipped",
        ),
        Case("1×1 source", family, "one texel for 8,192", "the same from everywhere", _one_texel_spread),
        Case(
            "512×256 source",
            family,
            "256 texels for one, a sun in one",
            "means by solid angle",
            lambda: _large(256, 512),
        ),
        Case(
            "4096×2048 source",
            family,
            "16,384 texels for one, a sun in one",
            "means by solid angle",
            lambda: _large(2048, 4096),
            slow=True,
        ),
        Case("map turned by 2π", family, "a whole turn", "no light is lost", lambda: _turned(2 * pi)),
        Case("map turned by 1e-9", family, "a sliver of every texel", "no light is lost", lambda: _turned(1e-9)),
    ]
