"""What an attack did: perceptibility, subsets, verification, images."""
