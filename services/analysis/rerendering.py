"""The re-rendering defence: fit the scene's parameters to an image, and classify the fitted scene's image instead.

The paper finds that image-space adversaries cannot be explained by physical parameters, so that the rendering of the
best fit has the original label again (section 4.1.1). Who defends this way knows the scene: its meshes, camera, and the
light and materials from which the fit starts.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product

from torch import Tensor

from services.analysis.fitting import Fit, Optimiser, fit
from services.analysis.perceptibility import of_images
from services.analysis.records import Explanation, Interpretation, Rerendering, Said
from services.attacks.run import Verifier
from services.rendering.color import from_bytes
from services.targets.scores import probability

RATES = (1e-3, 1e-4, 1e-5)
OPTIMISERS: tuple[Optimiser, ...] = ("sgd", "adam")
"""The paper's learning rates and optimisers."""


def said(logits: Tensor, labels: Sequence[str]) -> Said:
    """The answer that scores [K] give."""
    index = int(logits.argmax())
    return Said(label=labels[index], confidence=float(probability(logits, index)))


def interpret(verifier: Verifier, image: Tensor, *, steps: int, tick: Callable[[int, int], None]) -> Interpretation:
    """Fits the parameters of the verifier's renderer to an image, uint8 [H, W, 3], with each rate and optimiser.

    The renderer must be differentiable. `tick` is called before each image that is rendered.
    """
    labels, each = verifier.target.labels, steps + 2
    found: list[Explanation] = []
    for number, (optimiser, rate) in enumerate(product(OPTIMISERS, RATES)):
        begun, total = number * each, len(OPTIMISERS) * len(RATES) * each
        best, rendered = fitted(verifier, image, optimiser, rate, steps, partial(_tick_from, tick, begun, total))
        found.append(
            Explanation(
                optimiser=optimiser,
                rate=rate,
                losses=best.losses,
                after=said(verifier.logits(rendered), labels),
                distance=of_images(image, rendered),
            )
        )
    start = verifier.image({})
    return Interpretation(
        image=said(verifier.logits(image), labels), scene=said(verifier.logits(start), labels), fits=found
    )


def _tick_from(tick: Callable[[int, int], None], begun: int, total: int, step: int) -> None:
    tick(begun + step, total)


def rerender(
    verifier: Verifier,
    image: Tensor,
    *,
    optimiser: Optimiser,
    rate: float,
    steps: int,
    tick: Callable[[int, int], None],
) -> tuple[Rerendering, Tensor]:
    """Fits once; returns the answers to the image and to the rendering of the fit, and that image, uint8 [H, W, 3]."""
    labels = verifier.target.labels
    best, rendered = fitted(verifier, image, optimiser, rate, steps, lambda step: tick(step, steps + 2))
    record = Rerendering(
        optimiser=optimiser,
        rate=rate,
        losses=best.losses,
        before=said(verifier.logits(image), labels),
        after=said(verifier.logits(rendered), labels),
        distance=of_images(image, rendered),
    )
    return record, rendered


def fitted(
    verifier: Verifier, image: Tensor, optimiser: Optimiser, rate: float, steps: int, tick: Callable[[int], None]
) -> tuple[Fit, Tensor]:
    """A fit to an image, uint8 [H, W, 3], and its exact rendering, uint8 [H, W, 3]."""
    best = fit(verifier.renderer, from_bytes(image), optimiser, rate, steps, tick)
    tick(steps + 1)
    return best, verifier.image(best.perturbation)
