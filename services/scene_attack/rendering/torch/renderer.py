"""The differentiable renderer of the paper: a G-buffer shaded by a DSBRDF under an environment map.

The radiance of a pixel with normal n, for a distant viewer and distant light, is

    I = exposure · Σ_ω ρ(θ_h, θ_d) · chroma(ω) · ℓ(ω) · max(0, n·ω) · ΔΩ(ω),

with base_color as a factor on the lobes that have the mesh's colour (`dsbrdf.Layer`). The displayed value is its sRGB
curve on [0,1], composited over the ground by coverage. The viewer direction is the same for all pixels, from the
scene's origin to the camera: a modelling choice of the paper, under which θ_d depends on the light direction alone.
With the camera's `viewer` "perspective" each pixel has its own viewer direction. How the sum is computed for the
attacked groups is decided by a plan (planner) when the renderer is made; `smallest_map` chooses the size of an
environment map for a tolerance.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import torch
from torch import Tensor

from scene_attack.process import describe, device
from scene_attack.rendering.color import Canvas
from scene_attack.rendering.declaration import SHORTEST_WAVE, BuildRequest, DeclaredRenderer
from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.opengl.gbuffer import GBuffer, rasterise
from scene_attack.rendering.plan import DEFAULT_TOLERANCE, Item, Plan, Tolerance
from scene_attack.rendering.pose import MovingCamera, seen_from
from scene_attack.rendering.protocol import Parameters, Renderer
from scene_attack.rendering.torch import bump, dials, dsbrdf, paint, shape
from scene_attack.rendering.torch.bump import Bump
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.rendering.torch.dsbrdf import MATERIAL_UNIT, layers, preset
from scene_attack.rendering.torch.lamp import LOWEST, Lamp
from scene_attack.rendering.torch.lattice import Lattice, Places, own_points
from scene_attack.rendering.torch.light import LIGHT_GROUPS, Illumination, directions, illumination, solid_angles
from scene_attack.rendering.torch.moved import MovedScenes, places
from scene_attack.rendering.torch.paint import Paint
from scene_attack.rendering.torch.planner import compile_plan, looked_at, map_error
from scene_attack.rendering.torch.shader import Recipe, Shader, Sky, Surface
from scene_attack.rendering.torch.shading import Directions
from scene_attack.rendering.torch.shape import Shape
from scene_attack.rendering.torch.surfaces import VisibleSurfaces, regions, visibility, visible_surfaces
from scene_attack.rendering.torch.table import MAX_ANGLE
from scene_attack.rendering.variation import Variation
from scene_attack.scenes.description import MAP_SIZES
from scene_attack.scenes.environment import average
from scene_attack.scenes.resolve import ResolvedScene

TURNED_INTO = {"bump": "normals", "dials": "material", "lamp": "illumination_rgb"}
"""The group whose values another one's are turned into, for the planner: it plans for any values of these."""
ADDED = ("bump", "dials", "paint", "lamp", "shape")
"""Groups that are 0 at the start, where they leave every bit of the image as it is without them."""


def ignored_items(scene: ResolvedScene) -> Iterator[Item]:
    """Yields items on the surface properties of the scene that the renderer does not use."""
    why = "metallic, roughness, emission and occlusion are ignored: the torch renderer has materials of its own"
    parts = [part for placed in scene.placed if not placed.given_surface for part in placed.mesh.parts]
    if own := sum(part.metallic_roughness is not None for part in parts):
        yield Item(what="materials of the file", kept=0, of=own, why=why)
    if n_given := sum(placed.given_surface for placed in scene.placed):
        why = "the fields are pyrender's: the torch renderer has materials of its own, named in `material`"
        yield Item(what="metallic and roughness", kept=0, of=n_given, why=why)


def surface_items(visible: VisibleSurfaces) -> Iterator[Item]:
    """Yields the item on pixels that show several surfaces."""
    if visible.turns is not None:
        count = len(visible.angles)
        why = (
            "in a pixel at an outline each surface is shaded by itself, and their colours are averaged by their shares"
        )
        yield Item(what="surfaces of pixels", kept=count, of=count, why=why)


class TorchRenderer(DeclaredRenderer):
    """Renders a G-buffer under an environment map. Each of its groups is differentiable.

    bump [objects, nodes, nodes, nodes]: heights of dents on a lattice in each object's frame, in thousandths of the
    object's size (scene_attack.rendering.torch.bump), which turn the normals of every view of it.
    normals [H, W, 2]: azimuth and polar angle in the camera's frame, radians (see `normals`). They are 0 and have no
    effect at pixels that no object covers.
    illumination [rows, cols]: one intensity per texel of the map, ≥ 0, of mean ILLUMINATION_MEAN; the texel's colour is
    fixed.
    illumination_rgb [rows, cols, 3]: added to each texel's intensity, in each colour channel by itself; 0 at the start.
    The sum is held at ≥ 0. Only requests that name this group attack it: the paper's light has one channel.
    dials [objects, 5]: roughness, gloss and tint of each object's material, in natural ranges
    (scene_attack.rendering.torch.dials), which turn it; 0 at the start.
    shape [objects, nodes, nodes, nodes, 3]: displacements of each object's points on that lattice, in thousandths of
    its size (scene_attack.rendering.torch.shape), which move its outline and shadow; 0 at the start.
    paint [objects, nodes, nodes, nodes, 3]: shares of each object's surface, by channel, that the lightest or darkest
    printable colour covers (scene_attack.rendering.torch.paint), on a lattice in its frame; 0 at the start.
    lamp [7]: turn, brightness and colour temperature of the map, and a lamp that is added to it, as shares of what a
    room could have (scene_attack.rendering.torch.lamp); 0 at the start.
    material [objects, 3, 3, 2, 6]: Bernstein coefficients of log κ and log γ by object, colour channel and lobe
    (scene_attack.rendering.torch.dsbrdf), times MATERIAL_UNIT.
    """

    declaration = TORCH

    def __init__(
        self,
        scene: ResolvedScene,
        gbuffer: GBuffer | None = None,
        groups: Sequence[str] = TORCH.default_groups,
        tolerance: Tolerance = DEFAULT_TOLERANCE,
        seen: Tensor | None = None,
        wavelength: float = SHORTEST_WAVE,
        bent: Shape | None = None,
        few_images: bool = False,
    ) -> None:
        """Plans the rendering of `scene` for attacks on `groups`. `gbuffer`: None rasterises it here.

        Only these groups may then be rendered with other values than the scene's own, unless `tolerance` is "exact".
        "exact" computes in float64 throughout; with a number images are float32. `seen` is the visibility of a renderer
        of the same scene, so that it is found once; None: it is found here. `wavelength`, in sizes of an object, is the
        shortest of the waves of groups on a lattice. `bent` is the shape that the scene's meshes have been given. With
        `few_images` the plan prepares nothing that only many images would pay for.

        Raises InvalidRequest for an unknown material preset, and as `visibility` does.
        """
        dtype = torch.float64 if tolerance == "exact" else torch.float32
        self._lattice, self._bent = Lattice.of(wavelength), bent
        self._attacked, self._dtype, self._device = tuple(groups), dtype, device()
        where = describe(self._device)
        shaded_by = compiled.backend() if self._device.type == "cpu" else "torch"
        is_own = gbuffer is None
        gbuffer = rasterise(scene) if gbuffer is None else gbuffer
        height, width = gbuffer.coverage.shape
        self.size = (height, width)
        self.backend = (
            f"torch {torch.__version__} {where} {str(dtype).removeprefix('torch.')} threads {torch.get_num_threads()}, "
            f"shading {shaded_by}; {gbuffer.backend}"
        )
        gbuffer = gbuffer.to(self._device)  # OpenGL drew it on the CPU
        to_camera = torch.as_tensor(scene.view, dtype=torch.float64)[:3, :3].to(self._device)
        light = illumination(torch.as_tensor(scene.environment).to(self._device))
        sky = sky_of(light, to_camera)
        n_objects = len(scene.description.objects)
        materials = [preset(placed.described.material, f"{placed.field}.material") for placed in scene.placed]
        of_objects = layers([placed.described.material for placed in scene.placed])
        visible = visible_surfaces(gbuffer, to_camera)
        initial = {
            "normals": visible.image,
            "illumination": light.intensity,
            "illumination_rgb": torch.zeros_like(light.chroma),
            "material": torch.stack(materials).to(self._device) * MATERIAL_UNIT,
            "bump": self._lattice.zeros(n_objects),
            "dials": torch.zeros(n_objects, len(dials.NAMES), device=self._device),
            "paint": self._lattice.zeros(n_objects, 3),
            "lamp": torch.zeros(7, device=self._device),
            "shape": self._lattice.zeros(n_objects, 3),
            **places(scene),
        }
        # Round to float32 whatever the dtype, so that the exact twin renders the same scene.
        rounded = {group: value.to(self._device, torch.float32).double() for group, value in initial.items()}
        self._initial = {group: value.to(dtype) for group, value in rounded.items()}
        # What is fixed, and the floor, are last and no objects: their materials are no values of the group.
        self._initial["material"], self._fixed = self._initial["material"].tensor_split([n_objects])

        if seen is None:
            seen = visibility(scene, visible.shown.to(torch.device("cpu")))
        names = [placed.name for placed in scene.placed]
        near = scene.description.camera.viewer == "perspective"
        seen = None if seen is None else seen.to(self._device)
        parts = regions(visible.shown.object_index, seen, names, by_shadow=not near)
        self._owners, self._counts = parts.owners, parts.counts
        visible = visible.ordered(parts.order)
        shown, pixels = visible.shown, visible.shown.pixels
        self._turns = None if visible.turns is None else visible.turns.to(dtype)
        self._layers = [of_objects[k] for k in parts.owners]
        base_color = shown.base_color
        ground = torch.tensor(scene.ground, dtype=dtype, device=self._device)
        ground = ground if ground.dim() == 1 else ground.reshape(-1, 3)
        self._colors = torch.split(base_color.to(dtype), self._counts)
        self._lobes = dials.kinds([placed.described.material for placed in scene.placed[:n_objects]]).to(self._device)
        none = base_color.new_zeros(1, 3)
        lightest = [torch.cat([base_color[shown.object_index == k], none]).amax(0) for k in range(n_objects)]
        self._dials = dials.bounds(self._lobes, torch.stack(lightest))
        # The radiance of an object with layers has its colours already.
        own_colors = [
            color if len(own) == 1 else torch.ones_like(color)
            for color, own in zip(self._colors, self._layers, strict=True)
        ]
        covered = shown.share[:, None].to(dtype)
        self._canvas = Canvas(self.size, pixels, torch.cat(own_colors), covered, ground, visible.ranks)

        surfaces = [
            Surface(
                name,
                own,
                layer.base_color(color.double()),
                layer.material(material),
                own_viewers if near else None,
                layer.words,
                layer.share,
                hidden,
                fixed_material=layer.owner >= n_objects,
                fixed_color=layer.owner >= n_objects or not layer.colored,
            )
            for name, own_layers, own, color, material, own_viewers, hidden in zip(
                parts.names,
                self._layers,
                torch.split(visible.angles, self._counts),
                torch.split(base_color, self._counts),
                [rounded["material"][k] for k in parts.owners],
                torch.split(viewers_of(scene, self.size).to(self._device)[pixels], self._counts),
                parts.visibilities,
                strict=True,
            )
            for layer in own_layers
        ]
        intensity = rounded["illumination"].flatten()
        items = [*ignored_items(scene), *surface_items(visible)]

        def compiled_plan() -> tuple[list[Recipe], Plan]:
            n_pixels = self._canvas.n_pixels
            planned = tuple(dict.fromkeys(TURNED_INTO.get(group, group) for group in groups))
            hardest = [*self._hardest(surfaces, rounded["material"])]
            return compile_plan(hardest, sky, intensity, planned, tolerance, self.size, items, n_pixels, few_images)

        what = "recipes", self._attacked, tolerance, few_images
        recipes, plan = scene.once(what, compiled_plan) if is_own else compiled_plan()
        self.shaders = [
            Shader(recipe, sky, surface, intensity) for recipe, surface in zip(recipes, surfaces, strict=True)
        ]
        self._made_of, self._to_camera = (scene, gbuffer, seen), to_camera
        self._is_exact, self._tolerance = tolerance == "exact", tolerance
        self._plan, self._shaded, self._light, self._map = plan, (shown, surfaces), (sky, intensity), light

    @classmethod
    def build(cls, request: BuildRequest) -> "TorchRenderer":
        """Rasterises the request's scene and makes its renderer. Raises InvalidRequest as `shape.check_meshes` does."""
        if "shape" in request.groups:
            shape.check_meshes(request.scene, Lattice.of(request.wavelength))
        return cls(request.scene, None, request.groups, request.tolerance, wavelength=request.wavelength)

    @cached_property
    def plan(self) -> Plan:
        """The plan. The error due to the map's size is measured on first access, as drawing alone does not need it."""
        error = self._made_of[0].once("error of the map's size", self._map_error)
        # It was compiled for what the attacked groups are turned into.
        return self._plan.model_copy(update={"environment_map_error": error, "groups": self._attacked})

    @cached_property
    def _elsewhere(self) -> MovedScenes:
        """The renderers of the scene from other cameras and with its objects elsewhere or in other shapes."""
        groups, wavelength = self._attacked, 2 / self._lattice.cells

        def make(scene: ResolvedScene, bent: Shape | None) -> TorchRenderer:
            return TorchRenderer(
                scene, None, groups, self._tolerance, wavelength=wavelength, bent=bent, few_images=True
            )

        return MovedScenes(self._made_of[0], self, make)

    @cached_property
    def _places(self) -> Places:
        """Places of the surfaces on the lattices of their objects, where they are before these are bent."""
        points, index, is_object = own_points(self._made_of[0], self._shaded[0], self._device)
        if self._bent is not None:
            points = self._bent.rest(points, index)
        return Places.at(self._lattice, points, index, is_object)

    @cached_property
    def bump(self) -> Bump:
        """The places of the surfaces among the dents of their objects."""
        stretch = None if self._bent is None else self._bent.stretch(self._places)
        return Bump.of(self._made_of[0], self._shaded[0], self._places, self._to_camera, stretch)

    @cached_property
    def paint(self) -> Paint:
        """The places of the surfaces among the paint of their objects."""
        return Paint(self._shaded[0], self._places)

    @cached_property
    def _without_color(self) -> Canvas:
        """The canvas for radiance that has the surfaces' colours already."""
        return replace(self._canvas, base_color=torch.ones_like(self._canvas.base_color))

    def turned(self, settings: Tensor) -> Tensor:
        """Returns the materials [objects, 3, 3, 2, 6] of the scene's objects, turned by dials [objects, 5]."""
        own = self._initial["material"]
        return dials.turned(own, settings.to(own), self._lobes)

    @cached_property
    def lamp(self) -> Lamp:
        """The map that the group `lamp` turns and dims, and adds a lamp to."""
        return Lamp.of(self._made_of[0], self._map)

    def initial(self) -> Parameters:
        """Returns the scene's own values, {group: tensor}, in the renderer's dtype, rounded to float32."""
        return {group: value.cpu().clone() for group, value in self._initial.items()}

    def bounds(self) -> Mapping[str, tuple[Tensor, Tensor]]:
        """Returns the lowest and highest value of each group, {group: (low, high)}, broadcastable to it.

        Light is not negative; κ and γ stay in the ranges of `dsbrdf`; any angle is a normal, and angles are bounded so
        that float32 still resolves them (see `normals`). Dents, shapes, dials, paint and lamps are bounded by what a
        thing and a room could have (see `bump`, `shape`, `dials`, `paint` and `lamp`).
        """
        furthest = torch.tensor(MAX_ANGLE, dtype=self._dtype)
        lowest, highest = MovingCamera(self._made_of[0]).bounds
        infinity, deepest, furthest_bent = (
            torch.tensor(value, dtype=self._dtype) for value in (torch.inf, bump.LARGEST, shape.LARGEST)
        )
        ranges = torch.tensor([dsbrdf.LOG_KAPPA_RANGE, dsbrdf.LOG_GAMMA_RANGE], dtype=self._dtype) * MATERIAL_UNIT
        return {
            "normals": (-furthest, furthest),
            "illumination": (torch.zeros((), dtype=self._dtype), infinity),
            "illumination_rgb": (-self._initial["illumination"][..., None].cpu(), infinity),
            "material": (ranges[:, :1], ranges[:, 1:]),
            "bump": (-deepest, deepest),
            "shape": (-furthest_bent, furthest_bent),
            "dials": (self._dials[0].cpu().to(self._dtype), self._dials[1].cpu().to(self._dtype)),
            "paint": (-torch.ones((), dtype=self._dtype), torch.ones((), dtype=self._dtype)),
            "lamp": (torch.tensor(LOWEST, dtype=self._dtype), torch.ones(7, dtype=self._dtype)),
            "translation": (-infinity, infinity),
            "rotation": (-infinity, infinity),
            "camera": (lowest.to(self._dtype), highest.to(self._dtype)),
        }

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Renders images [B, H, W, 3] in [0,1], in the renderer's dtype and on its device.

        Groups that are left out keep the scene's own values.

        Raises ValueError for a wrong shape or an unknown group.
        """
        batch = {len(value) for value in parameters.values()} or {1}
        if len(batch) > 1:
            raise ValueError(f"groups with different batch sizes {sorted(batch)}")
        for group, value in parameters.items():
            if group not in self._initial or value.shape[1:] != self._initial[group].shape:
                expected = {name: ("B", *initial.shape) for name, initial in self._initial.items()}
                raise ValueError(f"group {group!r} of shape {tuple(value.shape)}; wanted {expected}")
            if group not in self._attacked and not self._is_exact:  # the exact renderer takes every group
                raise ValueError(f"group {group!r} is not among {self._attacked}, which this renderer is compiled for")
        # One image at a time: its operations and shapes, and so its bits, do not depend on the rest of the batch.
        images = [
            self._image({group: value[b].to(self._device, self._dtype) for group, value in parameters.items()})
            for b in range(batch.pop())
        ]
        return torch.stack(images) if len(images) > 1 else images[0][None]

    def exact(self) -> "TorchRenderer":
        """Returns the exact renderer of the same scene, which computes in float64 without shortcuts.

        It is made on first access, as drawing alone does not need it.
        """
        return self._twin

    @cached_property
    def _twin(self) -> "TorchRenderer":
        scene, gbuffer, seen = self._made_of
        return (
            self
            if self._is_exact
            else TorchRenderer(
                scene, gbuffer, tolerance="exact", seen=seen, wavelength=2 / self._lattice.cells, bent=self._bent
            )
        )

    @property
    def failed_checks(self) -> int:
        """Number of times that an object's sampled check failed, so that its pixels were summed directly."""
        return sum(shader.summed_after_all for shader in self.shaders)

    def _image(self, parameters: Parameters) -> Tensor:
        """Renders one image [H, W, 3]; groups that are not given keep the scene's own values."""
        parameters = {
            group: value
            for group, value in parameters.items()
            if group not in ADDED or value.requires_grad or bool(value.any())
        }
        place = {group: value for group, value in parameters.items() if group in TORCH.moving_groups}
        if place:
            return self._elsewhere.image(
                place, {g: value for g, value in parameters.items() if g not in TORCH.moving_groups}
            )
        return self.still(parameters)

    def still(self, parameters: Parameters, drawn: Tensor | None = None) -> Tensor:
        """The image [H, W, 3] of the scene where it is. `drawn` are the coefficients of the shape that it has, limited,
        with a gradient that the image gets inside the outlines."""
        values = self._initial | parameters
        angles, intensity = self._canvas.covered(values["normals"]), values["illumination"].flatten()
        if self._turns is not None:
            angles = angles + self._turns
        if drawn is not None:
            angles = bump.tilted(angles, shape.slopes(self.bump, drawn - drawn.detach()))
        if "bump" in parameters:
            angles = self.bump.turned(angles, values["bump"])
        rgb = values["illumination_rgb"]
        if "lamp" in parameters:
            rgb = rgb + self.lamp.added(values["lamp"], values["illumination"])
        if "lamp" in parameters or "illumination_rgb" in parameters:
            intensity = (intensity + rgb.reshape(-1, 3).T).clamp_min(0.0)  # [3, D]
        if "dials" in parameters:
            values["material"] = dials.turned(values["material"], values["dials"], self._lobes)
        colors, canvas, painted = self._colors, self._canvas, "paint" in parameters
        if painted:
            colors = torch.split(self.paint.colors(torch.cat(colors), values["paint"]), self._counts)
            canvas = self._without_color
        shaders, materials = iter(self.shaders), [*values["material"], *self._fixed]
        shaded = []
        for parts, own, color, owner in zip(
            self._layers, torch.split(angles, self._counts), colors, self._owners, strict=True
        ):
            radiances = [
                next(shaders)(
                    own, intensity, layer.material(materials[owner]), layer.base_color(color) if painted else None
                ).to(self._dtype)
                for layer in parts
            ]
            body = color * radiances[0] if painted or len(parts) > 1 else radiances[0]
            shaded.append(body if len(parts) == 1 else body + radiances[1])
        return canvas.image(torch.cat(shaded) if len(shaded) > 1 else shaded[0])

    def _hardest(self, surfaces: Sequence[Surface], materials: Tensor) -> Iterator[Surface]:
        """Yields the surfaces as the plan is made for them, with the lightest colours and the narrowest highlights that
        the attacked groups may give. `materials` [objects, 3, 3, 2, 6], in which a floor may be last, are the scene's
        own."""
        if "dials" in self._attacked:
            turned = dials.turned(materials[: len(self._lobes)], dials.sharpest(self._dials), self._lobes)
            materials = torch.cat([turned, materials[len(self._lobes) :]])
        layers_of_surfaces = (layer for of_region in self._layers for layer in of_region)
        for surface, layer in zip(surfaces, layers_of_surfaces, strict=True):
            color = surface.base_color
            if "paint" in self._attacked and not surface.fixed_color:
                color = color.clamp_min(paint.PRINTABLE[1])
            yield replace(surface, material=layer.material(materials[layer.owner]), base_color=color)

    def _map_error(self) -> float | None:
        """Returns the error of a displayed value due to the environment map's size; None for the largest size."""
        scene, _, seen = self._made_of
        if scene.finest_environment is None:
            return None
        light = illumination(torch.as_tensor(scene.finest_environment).to(self._device))
        to_camera = torch.as_tensor(scene.view, dtype=torch.float64)[:3, :3].to(self._device)
        shown, surfaces = self._shaded
        if seen is not None:
            some = shown.some(looked_at(self._counts).to(self._device)).to(torch.device("cpu"))
            visible = visibility(replace(scene, environment=scene.finest_environment), some)
            seen = None if visible is None else visible.to(self._device)
        return map_error(surfaces, self._light, (sky_of(light, to_camera), light.intensity.flatten()), seen)


def sky_of(light: Illumination, to_camera: Tensor) -> Sky:
    """Returns a map's directions and powers in the camera's frame.

    `to_camera` [3, 3] turns world vectors, as rows, into that frame.
    """
    rows, cols = light.intensity.shape
    towards = directions(rows, cols).to(to_camera) @ to_camera
    half, theta_d = dsbrdf.half_vectors(towards, torch.tensor([0.0, 0.0, 1.0]).to(towards))
    power = (light.exposure * light.chroma).reshape(-1, 3).T * solid_angles(rows, cols).to(to_camera)
    return Sky(Directions.of(towards, half), dsbrdf.basis(theta_d) / MATERIAL_UNIT, power)


def viewers_of(scene: ResolvedScene, size: tuple[int, int]) -> Tensor:
    """Returns unit vectors from each pixel's surface point to the camera, in the camera's frame, float64 [H·W, 3]."""
    height, width = size
    across = torch.as_tensor(scene.projection, dtype=torch.float64)
    x = ((torch.arange(width, dtype=torch.float64) + 0.5) * 2 / width - 1) / across[0, 0]
    y = (1 - (torch.arange(height, dtype=torch.float64) + 0.5) * 2 / height) / across[1, 1]
    down, right = torch.meshgrid(y, x, indexing="ij")
    return torch.nn.functional.normalize(
        torch.stack((-right, -down, torch.ones_like(right)), -1).reshape(-1, 3), dim=-1
    )


def smallest_map(scene: ResolvedScene, tolerance: Tolerance) -> tuple[int, int]:
    """Returns the smallest of MAP_SIZES whose displayed values are within `tolerance` of those of the largest.

    The values are compared at the pixels that `map_error` samples. The result is the largest size where no smaller one
    suffices, for "exact", and for a scene without a source map (one that was not resolved from a library).
    """
    if scene.source_map is None or tolerance == "exact":
        return MAP_SIZES[-1]
    gbuffer, rotation = rasterise(scene), scene.description.lights.environment.rotation
    for size in MAP_SIZES[:-1]:
        averaged = replace(scene, environment=average(scene.source_map, *size, rotation))
        error = TorchRenderer(averaged, gbuffer, tolerance="exact").plan.environment_map_error
        if error is None or error <= tolerance:
            return size
    return MAP_SIZES[-1]


def varied(renderer: Renderer, parameters: Mapping[str, Tensor], variation: Variation) -> Parameters:  # noqa: ARG001
    """Returns the values [B, …] by group under a variation of the view and of the map's intensity: all light is scaled,
    also that which is attacked in one channel.

    The map stays where it is, since each texel of the group `illumination` keeps its colour.
    """
    factor = dict.fromkeys(LIGHT_GROUPS, variation.intensity)
    lit = {group: value * factor.get(group, 1.0) for group, value in parameters.items()}
    return lit | {group: seen_from(value, variation) for group, value in parameters.items() if group == "camera"}
