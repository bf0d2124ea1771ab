"""What an attack did: perceptibility, subsets, verification, pictures."""
