"""The differentiable renderer: normals, illumination and material, shaded by torch and kernels."""
