"""Measures of an attack's outcome: perceptibility, subset ablation, the network's answers, images."""
