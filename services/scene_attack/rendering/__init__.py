"""Renderers: named parameter groups in, images out."""
