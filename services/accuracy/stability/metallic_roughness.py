"""The radiance of a glTF material straight from docs/gltf.md, in float64 numpy: a reference.

The BRDF is pyrender's, written in angles: GGX with α = roughness² (Walter et al. 2007, equation 33), Schlick's Fresnel
term, Schlick's approximation of Smith's shadowing with k = (roughness + 1)² / 8, a diffuse body. It shares no code and
no constant with services.rendering.
"""

from dataclasses import dataclass
from math import pi

import numpy as np

from services.accuracy.stability.lamps import Lamps
from services.scenes.mesh import Doubles

SMOOTHEST = 0.04
"""The lowest roughness that is drawn."""


@dataclass(frozen=True)
class Surface:
    """A material: `texel` [3] multiplies the base colour; `normal` [3], a unit vector, replaces the geometry's. If
    `given`, its metallic and roughness are a scene's, and its shadowing is Smith's, height-correlated (Heitz 2014)."""

    metallic: float
    roughness: float
    texel: tuple[float, float, float] = (1.0, 1.0, 1.0)
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    occlusion: float = 1.0
    normal: tuple[float, float, float] | None = None
    given: bool = False

    def radiance(self, positions: Doubles, normals: Doubles, colors: Doubles, eye: Doubles, lamps: Lamps) -> Doubles:
        """Linear radiance [P, 3] as `lamps.radiance` has it, of base colours [P, 3].

        The sky has radiance ambient · (1 + w_y / 2) in direction w: a rough surface sees its cosine-weighted mean and a
        smooth one what it mirrors, and the occlusion map darkens this light alone.
        """
        normals = normals if self.normal is None else np.tile(self.normal, (len(positions), 1))
        base, rough = colors * self.texel, max(self.roughness, SMOOTHEST)
        body, f0 = 0.96 * (1 - self.metallic) * base, 0.04 * (1 - self.metallic) + self.metallic * base
        to_eye = (eye - positions) / np.linalg.norm(eye - positions, axis=1, keepdims=True)
        seen = _cosine(normals, to_eye)
        share = f0 + np.maximum(1 - rough - f0, 0) * (1 - seen) ** 5
        mean, mirrored = 1 + normals[:, 1:2] / 3, 1 + (2 * seen * normals - to_eye)[:, 1:2] / 2
        sky = (1 - share) * body * mean + share * (rough * mean + (1 - rough) * mirrored)
        total = np.array(self.emission) + lamps.ambient * self.occlusion * sky
        for facing_it, to_light in lamps.arriving(positions):
            lit = np.maximum(_cosine(normals, to_light), 0.0)
            half = (to_eye + to_light) / np.linalg.norm(to_eye + to_light, axis=1, keepdims=True)
            cosine = np.clip(_cosine(normals, half), 1e-9, 1.0)
            slope2, alpha = (1 - cosine**2) / cosine**2, rough**2
            distribution = alpha**2 / (pi * cosine**4 * (alpha**2 + slope2) ** 2)
            k = (rough + 1) ** 2 / 8
            # Each side's shadowing over its cosine, which cancels the cosine of the microfacet formula.
            shadowing = 1 / (seen * (1 - k) + k) / (lit * (1 - k) + k)
            if self.given:
                tangents = [np.sqrt(1 / np.maximum(one, 1e-9) ** 2 - 1) for one in (seen, lit)]
                beneath = sum((np.sqrt(1 + (alpha * one) ** 2) - 1) / 2 for one in tangents)
                shadowing = 1 / (1 + beneath) / (seen * np.maximum(lit, 1e-9))
            fresnel = f0 + (1 - f0) * (1 - _cosine(to_eye, half)) ** 5
            total = total + facing_it * lit * ((1 - fresnel) * body / pi + fresnel * distribution * shadowing / 4)
        return np.asarray(total)


def _cosine(one: Doubles, other: Doubles) -> Doubles:
    return np.asarray((one * other).sum(axis=1, keepdims=True))
