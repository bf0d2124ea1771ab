"""Ways to break shadows: maps that are not drawn, that lack objects or show them too near; rays that miss."""

import numpy as np

from services.rendering.opengl import context


def _patched(name: str, value):
    def apply(patch) -> None:
        context.current()  # before what imports OpenGL
        from services.rendering.opengl import shadow_maps

        patch.setattr(shadow_maps, name, value)

    return apply


no_maps = _patched("shadow_views", lambda _corners, _light: [])
no_casters = _patched("casters", lambda _corners, _plain, _light: [])


def too_near(patch) -> None:
    """Every depth is taken for half as large, and everything is in the maps, the ground too."""
    context.current()
    from services.rendering.opengl import shadow_maps
    from services.rendering.opengl.shadows import ShadowView

    row = ShadowView.row.fget
    patch.setattr(ShadowView, "row", property(lambda view: row(view) * np.array([1, 1, 1, 1.0]) * _half()))
    patch.setattr(shadow_maps, "casters", lambda corners, _plain, _light: list(range(len(corners))))


def _half() -> np.ndarray:
    factors = np.ones((4, 4))
    factors[2, 3] = 0.5  # the depth that 1 stands for
    return factors


def rays_miss(patch) -> None:
    """No triangle stops a ray."""
    from services.rendering.torch_renderer import surfaces

    casters = surfaces.casters
    patch.setattr(surfaces, "casters", lambda scene: tuple(of[:2] for of in casters(scene)))
