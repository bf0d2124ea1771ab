"""OpenGL through pyrender: context, framebuffers, programs, render passes, G-buffer."""
