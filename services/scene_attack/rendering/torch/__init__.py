"""The differentiable renderer: it shades normals under an environment map, in compiled kernels or in torch."""
