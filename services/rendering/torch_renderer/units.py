"""Defines the units of the torch renderer's parameter groups: how much a perturbation of 1 changes.

The paper gives learning rates but not the units of L and m. docs/materials.md says where these two come from.
"""

ILLUMINATION_MEAN = 10.0
"""Mean over the sphere (weighted by solid angle) of an unperturbed map's intensities. The exposure undoes it, so that
the image does not depend on it: a perturbation of 1 is a tenth of the map's mean."""

MATERIAL_UNIT = 30.0
"""Material coordinates per natural logarithm of κ or γ: a perturbation of 1 scales κ or γ by exp(1/30), about 3 %."""

WHITE = 0.9
"""Linear value to which the exposure scales the brightest channel of the most lit white Lambertian surface."""
