"""The published network of IEP (Johnson et al. 2017, https://github.com/facebookresearch/clevr-iep), without weights.

Whoever has the released weights converts them by `scene-attack targets convert-clevr-iep`; docs/targets.md says how.
ResNet-101 up to its third stage gives features of the image. A stem and one module for each function of the program,
each with its value, pass 128 channels at 14×14 cells on, and a classifier scores the answers. An LSTM reads the
question, another writes its program.

Three things differ from the published program. Four tokens that stand for no answer are not scored. A program that ends
early or does not fit together is refused, where theirs fills it up with `scene`. Images are resized without rounding to
8 bits, so that scores are differentiable with respect to the image as it was drawn.
"""
