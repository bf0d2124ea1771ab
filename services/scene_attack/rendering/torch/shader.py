"""The radiance of one object's pixels, by the method that its recipe names.

Each pixel is summed directly, or looked up in a table over normals (`table`) whose nodes are summed. A table is good
where radiance is smooth in the normal, and a few texels spoil that: each light has an edge where it sets behind the
surface's horizon, steep for a strong light, and a highlight, narrow under a sharp lobe. The light of these texels is
summed at every pixel, and the table holds the rest.

Either sum is done by the cheapest method that the attacked groups allow:

- cached_table: neither light nor material changes, so the table is a fixed function of the normal, filled where needed;
- precomputed_transport: only the light changes, so radiance is linear in it and its factors are computed once;
- summed: over directions and lobes, in every image, with its gradient.
"""

from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from scene_attack.rendering.color import to_display
from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.torch import dsbrdf
from scene_attack.rendering.torch.dsbrdf import MATERIAL_UNIT
from scene_attack.rendering.torch.shading import (
    Directions,
    Lobes,
    albedo,
    lambert_radiance,
    lambert_transport,
    perspective_radiance,
    radiance,
    transport,
)
from scene_attack.rendering.torch.table import TILE, chosen_pixels, look_up, nodes_of, tiles, to_vectors, touched

CHECKED = 256
"""Maximum number of pixels at which a looked-up image is checked against the direct sum."""

CHECKED_AT_FIXED_NORMALS = 2 * CHECKED
"""Maximum number of checked pixels where only the light changes: their factors are stored, so that a check is a
product."""

Method = Literal["cached_table", "precomputed_transport", "summed"]


@dataclass(frozen=True)
class Sky:
    """The light's side of a scene, float64: directions, `curves` [D, 6] (θ_d's Bernstein basis, per unit of material)
    and `power` [3, D], the radiance times solid angle of one unit of intensity."""

    directions: Directions
    curves: Tensor
    power: Tensor


@dataclass(frozen=True)
class Recipe:
    """The method by which one object is shaded: the executable side of its plan.

    active_texels: the texels of the map that are used at all [D]. gray: the three channels have the same lobes.
    varying, straight: bool [3, lobes], the lobes that are summed and those that are a straight line in log n·h; the
    others are left out. rows: of the table over normals, None where there is no table. per_pixel_texels: those active
    texels that are summed at the pixels beside the table [K]. moving: whether normals are attacked. guard: the
    displayed error at a checked pixel beyond which the whole image is summed directly, None for no check. lambert:
    whether the reflectance is taken to be the same for all directions of light and viewer.
    """

    active_texels: Tensor
    gray: bool
    varying: Tensor
    straight: Tensor
    method: Method
    moving: bool
    rows: int | None = None
    per_pixel_texels: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.int64))
    dtype: torch.dtype = torch.float32
    guard: float | None = None
    lambert: bool = False

    @property
    def channels(self) -> int:
        """Colour channels whose lobes are evaluated."""
        return 1 if self.gray else dsbrdf.CHANNELS

    @property
    def lobes(self) -> int:
        """Lobes summed in each channel."""
        return int(self.varying.sum(1).max())


@dataclass(frozen=True)
class Surface:
    """The visible surface of one object, or of a layer of it: angles [P, 2] and base_color [P, 3] of its pixels,
    material [3, lobes, 2, 6]; float64.

    `viewers` [P, 3] are unit vectors to the camera where each pixel has its own, None for a distant viewer. `layer`
    says on plans which lobes these are, "" for all, and `share` is the part of the tolerance that its error may take.
    `visibility` uint8 [D of the whole map, P] is each texel's share that a pixel sees, in units of 1/255; None where
    nothing is hidden. A fixed material is not among the values of the group `material`, nor is a fixed colour among
    those that `paint` changes.
    """

    name: str
    angles: Tensor
    base_color: Tensor
    material: Tensor
    viewers: Tensor | None = None
    layer: str = ""
    share: float = 1.0
    visibility: Tensor | None = None
    fixed_material: bool = False
    fixed_color: bool = False

    def with_layer(self, what: str) -> str:
        """Returns the words of a plan for `what` of this surface: with those of its layer, if it is one of several."""
        return f"{what} {self.layer}".strip()


class Shader:
    """Radiance [P, 3] of an object's pixels, by its recipe.

    `summed_after_all` counts the images whose sampled check failed.
    """

    def __init__(self, recipe: Recipe, sky: Sky, surface: Surface, illumination: Tensor) -> None:
        """`surface` and `illumination` [D of the whole map] are the scene's own, for what does not change."""
        self.recipe = recipe
        angles = surface.angles.to(recipe.dtype)
        pixels = None if recipe.moving else to_vectors(angles)
        frozen = (surface.material, illumination)
        still = pixels if recipe.rows is None else None
        self._whole = _Sum(recipe, recipe.active_texels, sky, frozen, still, surface.viewers, surface.visibility)
        if recipe.rows is not None:
            among = torch.isin(recipe.active_texels, recipe.per_pixel_texels.to(recipe.active_texels.device))
            self._still_tiles = None if recipe.moving else touched(angles, recipe.rows)
            still_tiles = self._still_tiles
            self._still_nodes = None if still_tiles is None else nodes_of(still_tiles, recipe.rows, recipe.dtype)
            at_nodes = None if self._still_nodes is None else self._still_nodes.vectors
            self._smooth = _Sum(recipe, recipe.active_texels[~among], sky, frozen, at_nodes)
            self._sharp = _Sum(recipe, recipe.active_texels[among], sky, frozen, pixels)
            self._color = surface.base_color.to(recipe.dtype)
            self._fixed_check = None
            if (
                recipe.method == "precomputed_transport" and pixels is not None
            ):  # their factors are stored, so they stay
                self._fixed_check = torch.arange(
                    0, len(angles), max(1, len(angles) // CHECKED_AT_FIXED_NORMALS), device=angles.device
                )
                self._checked_sum = _Sum(recipe, recipe.active_texels, sky, frozen, pixels[self._fixed_check])
            self._known = torch.zeros(len(tiles(recipe.rows)), dtype=torch.bool, device=angles.device)
            self._table = torch.zeros(2 * recipe.rows**2, 3, dtype=recipe.dtype, device=angles.device)
        self.summed_after_all = 0

    def __call__(
        self, angles: Tensor, illumination: Tensor, material: Tensor, base_color: Tensor | None = None
    ) -> Tensor:
        """Radiance [P, 3] for angles [P, 2], all intensities, [D of the whole map] or [3, D] where each channel has its
        own, and one material [3, lobes, 2, 6]. `base_color` [P, 3] is what a table's check multiplies it by; None: the
        surface's own."""
        angles, recipe = angles.to(self.recipe.dtype), self.recipe
        if recipe.rows is None:
            return self._whole(to_vectors(angles), illumination, material)
        filled = touched(angles, recipe.rows) if self._still_tiles is None else self._still_tiles
        optional = recipe.guard is not None and recipe.moving and recipe.method == "summed"
        if optional and int(filled.sum()) * TILE**2 >= len(angles):  # the table would be the longer sum
            return self._whole(to_vectors(angles), illumination, material)
        table = self._filled(filled, illumination, material)
        shaded = look_up(table, angles)
        if len(recipe.per_pixel_texels):
            shaded = shaded + self._sharp(to_vectors(angles), illumination, material)
        if recipe.guard is None:
            return shaded
        with torch.no_grad():
            color = self._color if base_color is None else base_color.to(recipe.dtype)
            if self._fixed_check is None:
                at = chosen_pixels(CHECKED, table, filled, recipe.rows, angles, shaded, color)
                truth = self._whole(to_vectors(angles[at]), illumination, material)
            else:
                at = self._fixed_check
                truth = self._checked_sum(to_vectors(angles[at]), illumination, material)
            held = displayed_error(shaded[at], truth, color[at]) <= recipe.guard
        if held:
            return shaded
        self.summed_after_all += 1
        return self._whole(to_vectors(angles), illumination, material)

    def _filled(self, tile_mask: Tensor, illumination: Tensor, material: Tensor) -> Tensor:
        """Returns the table with every node of the tiles that `tile_mask` marks."""
        recipe = self.recipe
        assert recipe.rows is not None
        if recipe.method != "cached_table":
            nodes = self._still_nodes or nodes_of(tile_mask, recipe.rows, recipe.dtype)
            return self._table.index_copy(0, nodes.places, self._smooth(nodes.vectors, illumination, material))
        missing = tile_mask & ~self._known
        if bool(missing.any()):
            if not compiled.runs(self._table):  # in torch a value's last bits depend on its neighbours: all at once
                missing = torch.ones_like(missing)
            nodes = nodes_of(missing, recipe.rows, recipe.dtype)
            values = self._smooth(nodes.vectors, illumination, material)
            self._table = self._table.index_copy(0, nodes.places, values)  # a graph may still hold the old one
            self._known |= missing
        return self._table


def checked_pixels(recipe: Recipe) -> int:
    """Maximum number of pixels of a looked-up image that are checked against the direct sum."""
    return CHECKED_AT_FIXED_NORMALS if recipe.method == "precomputed_transport" else CHECKED


class _Sum:
    """The sum over some directions at any normals, or at fixed normals where its factors are stored
    ("precomputed_transport")."""

    def __init__(
        self,
        recipe: Recipe,
        kept: Tensor,
        sky: Sky,
        frozen: tuple[Tensor, Tensor],
        normals: Tensor | None,
        viewers: Tensor | None = None,
        visibility: Tensor | None = None,
    ) -> None:
        """`frozen` are the scene's own material and illumination; `normals` [N, 3] where they do not change; `viewers`
        [N, 3] where each normal has its own; `visibility` as in `Surface`."""
        self._recipe, self._kept = recipe, kept
        self._viewers = None if viewers is None else viewers.to(recipe.dtype)
        self._visibility = None if visibility is None else visibility[kept].contiguous()
        self._directions = sky.directions.only(kept).to(recipe.dtype)
        self._curves, power = sky.curves[kept].to(recipe.dtype), sky.power[:, kept]
        if recipe.lambert:  # the light is then what the surface reflects of it
            reflected = albedo(frozen[0])
            assert reflected is not None
            power = power * reflected[:, None]
        self._power = power.to(recipe.dtype)
        self._plain = bool(recipe.varying.all()) and not bool(recipe.straight.any())
        self._lobes = self._light = self._factors = None
        if recipe.method != "summed" and not recipe.lambert:
            self._lobes = self._lobes_of(frozen[0].to(recipe.dtype))
        if recipe.method == "cached_table":
            self._light = self._light_of(frozen[1])
        if recipe.method == "precomputed_transport" and normals is not None:
            if recipe.lambert:
                self._factors = lambert_transport(normals, self._directions.towards, self._visibility)
            else:
                assert self._lobes is not None
                self._factors = transport(normals, self._lobes, self._directions, self._visibility)

    def __call__(self, normals: Tensor, illumination: Tensor, material: Tensor) -> Tensor:
        """Radiance [N, 3]; `normals` are ignored where factors for them are stored."""
        if self._factors is None:
            return self.summed(normals, illumination, material)
        light = self._light_of(illumination)
        if len(self._factors) == 1:
            return (light @ self._factors[0]).T
        return torch.stack([light[c] @ factors for c, factors in enumerate(self._factors)], dim=-1)

    def summed(self, normals: Tensor, illumination: Tensor, material: Tensor) -> Tensor:
        """Radiance [N, 3] at any normals."""
        light = self._light_of(illumination) if self._light is None else self._light
        if self._recipe.lambert:
            return lambert_radiance(normals, light, self._directions.towards, self._visibility)
        if self._viewers is not None:
            own = material[: 1 if self._alike(material) else dsbrdf.CHANNELS].to(self._recipe.dtype) / MATERIAL_UNIT
            return perspective_radiance(normals, self._viewers, light, own, self._directions.towards, self._visibility)
        lobes = self._lobes_of(material.to(self._recipe.dtype)) if self._lobes is None else self._lobes
        return radiance(normals, light, lobes, self._directions, self._visibility)

    def _light_of(self, illumination: Tensor) -> Tensor:
        return self._power * illumination[..., self._kept].to(self._recipe.dtype)

    def _alike(self, material: Tensor) -> bool:
        """Whether one channel stands for all three: equal channels without gradients give the same bits."""
        return self._recipe.gray or (not material.requires_grad and bool((material == material[:1]).all()))

    def _lobes_of(self, material: Tensor) -> Lobes:
        """The recipe's lobes at the directions, of coefficients [3, lobes, 2, 6] in the group's units."""
        log_kappa, gamma = dsbrdf.lobes(material[: 1 if self._alike(material) else dsbrdf.CHANNELS], self._curves)
        if not self._plain:
            return straightened(log_kappa, gamma, self._recipe.varying, self._recipe.straight)
        flat = log_kappa.new_zeros(len(log_kappa), log_kappa.shape[-1])
        return Lobes(flat, flat, log_kappa, gamma)


def straightened(log_kappa: Tensor, gamma: Tensor, varying: Tensor, straight: Tensor) -> Lobes:
    """The lobes [C, LOBES, D] chosen by `varying` as they are, those chosen by `straight` as a line.

    With e = exp(log κ), exp(e · exp(γ log n·h)) − 1 ≈ exp(e) − 1 + e exp(e) γ log n·h. All channels keep as many lobes
    as the one that needs most.
    """
    channels, _, count = log_kappa.shape  # 1 where the channels are alike
    exponent = log_kappa.clamp(*dsbrdf.LOG_EXPONENT_RANGE).exp()
    chosen = straight[:channels, :, None]
    base = (torch.expm1(exponent) * chosen).sum(1)
    tilt = (exponent * exponent.exp() * gamma * chosen).sum(1)
    most = int(varying[:channels].sum(1).max())
    kept_kappa = log_kappa.new_full((channels, most, count), dsbrdf.LOG_EXPONENT_RANGE[0])
    kept_gamma = gamma.new_zeros(channels, most, count)
    for c in range(channels):
        which = varying[c].nonzero()[:, 0]
        kept_kappa[c, : len(which)], kept_gamma[c, : len(which)] = log_kappa[c, which], gamma[c, which]
    return Lobes(base, tilt, kept_kappa, kept_gamma)


def displayed_error(values: Tensor, truth: Tensor, base_color: Tensor) -> float:
    """The largest difference of displayed colours between two radiances [P, 3], in the dtype of `truth`."""
    if not len(values):
        return 0.0
    color = base_color.to(truth.dtype)
    return float((to_display(values.to(truth.dtype) * color) - to_display(truth * color)).abs().max())
