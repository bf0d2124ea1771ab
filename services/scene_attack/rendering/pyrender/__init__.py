"""The non-differentiable renderer: lights, colours and poses, drawn by pyrender's OpenGL."""
