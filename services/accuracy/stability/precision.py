"""Eight bits of mantissa, and seeds at the ends of their range."""

import hashlib

import numpy as np
import torch
from pydantic import TypeAdapter, ValidationError

from services.accuracy.placing import placed, sky
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.definition import displayed
from services.accuracy.stability.linear import SIDE, linear_network
from services.accuracy.stability.shading import Shading
from services.attacks.attack import LARGEST_SEED, Seed
from services.attacks.goal import ResolvedGoal
from services.attacks.seeds import generator
from services.errors import InvalidRequest
from services.rendering.color import as_saved, to_display
from services.rendering.image_renderer import ImageRenderer
from services.scenes.image_file import to_linear


def _parameters() -> Measured:
    """Parameters in bfloat16 are those numbers, no worse: the image is computed in the renderer's own type."""
    shading = Shading.of(placed(radiance=sky()))
    short = {g: shading.renderer.initial()[g].to(torch.bfloat16) for g in shading.renderer.plan.groups}
    image = shading.renderer.render({g: v[None] for g, v in short.items()})
    need(image.dtype == torch.float32, f"the image is {image.dtype}")
    found = shading.errors(short)
    return found.within(shading.due, "largest error of a displayed value, against the definition of these numbers")


def _image() -> Measured:
    """An image in bfloat16 is saved as the 8 bits nearest to what it holds."""
    values = torch.linspace(0, 1, 4096).to(torch.bfloat16)
    wanted = torch.from_numpy(np.rint(values.double().numpy() * 255) / 255)
    shown = ImageRenderer(values.reshape(64, 64, 1).expand(-1, -1, 3), "numbers").initial()["image"]
    need(shown.dtype == torch.float32, f"the image is {shown.dtype}")
    return Measured(
        float((as_saved(values).double() - wanted).abs().max()), 1e-7, "difference from rounding in float64"
    )


def _curve() -> Measured:
    """The display curve, its inverse and its derivative by the standard's formula, in both types, ends included."""
    linear = np.concatenate([np.linspace(-0.5, 1.5, 4001), [0.0, 1.0, 0.0031308, 1e-7]])
    wanted = displayed(linear)
    worst = 0.0
    for dtype in (torch.float32, torch.float64):
        given = torch.from_numpy(linear).to(dtype).requires_grad_(True)
        shown = to_display(given)
        (gradient,) = torch.autograd.grad(shown.sum(), given)
        worst = max(worst, float(np.abs(shown.detach().double().numpy() - wanted).max()))
        inside = (linear > 1e-5) & (linear < 1 - 1e-5) & (np.abs(linear - 0.0031308) > 1e-5)
        steep = (displayed(linear[inside] + 1e-6) - displayed(linear[inside] - 1e-6)) / 2e-6
        worst = max(worst, 0.1 * float(np.abs(gradient.double().numpy()[inside] / steep - 1).max()))
        need(not bool(gradient[(given < 0) | (given > 1)].any()), "what is clipped has a gradient")
    worst = max(worst, float(np.abs(to_linear(wanted) - np.clip(linear, 0, 1)).max()))
    # Float32 has 1e-7, three times over; the standard's constants meet at the knee to 3e-8.
    return Measured(worst, 5e-7, "error of displayed and linear values, and a tenth of the gradient's relative one")


def _scores() -> Measured:
    """Log-odds of bfloat16 scores lose nothing more: sums of exponentials are not taken in bfloat16."""
    scores = torch.randn(20, 1000, generator=torch.Generator().manual_seed(4)).to(torch.bfloat16)
    goal = ResolvedGoal((7,), None)
    wanted, found = goal.objective(scores.double()), goal.objective(scores)
    return Measured(
        float((found.double() - wanted).abs().max() / wanted.abs().max()),
        1e-6,
        "relative error of the log-odds, against float64",
    )


def _network() -> Measured:
    """A network in bfloat16 hands out float32 scores, as close as its own type allows."""
    images = torch.rand(8, SIDE, SIDE, 3, generator=torch.Generator().manual_seed(6))
    short, long = (linear_network(dtype=t).logits(images) for t in (torch.bfloat16, torch.float64))
    need(short.dtype == torch.float32, f"the scores are {short.dtype}")
    error = float((short.double() - long.double()).abs().max() / long.abs().max())
    # Weights and pixels rounded to 8 bits of mantissa, 192 products that err at random, and the score itself.
    return Measured(error, 2 * 2.0**-8, "error of a score relative to the largest, against float64")


def _seeds() -> Measured:
    """Streams at the ends of the range are reproducible, different, and depend on the seed's every bit."""
    ends = (0, 1, LARGEST_SEED - 1, LARGEST_SEED)
    first, second = ([torch.rand(8, generator=generator(seed, "zoo", 3)) for seed in ends] for _ in range(2))
    need(all(torch.equal(a, b) for a, b in zip(first, second, strict=True)), "the same seed gives other numbers")
    different = min(float((a - b).abs().max()) for i, a in enumerate(first) for b in first[:i])
    need(different > 1e-3, "two seeds give the same numbers")
    text = hashlib.sha256(f"{LARGEST_SEED}/zoo/3".encode()).digest()
    again = torch.rand(8, generator=torch.Generator().manual_seed(int.from_bytes(text[:8], "big") % 2**63))
    return Measured(float((again - first[3]).abs().max()), 0.0, "difference from the stream derived by hand")


def _refused(seed: int) -> Measured:
    try:
        TypeAdapter(Seed).validate_python(seed)
    except ValidationError as error:
        raise InvalidRequest("seed", error.errors()[0]["msg"]) from error
    return Measured(float(seed), -1.0, "the seed")


def cases() -> list[Case]:
    """The cases of this family."""
    family, refused = "precision", "a clear error names the field"
    return [
        Case("bf16 parameters", family, "8 bits of mantissa", "shaded in float32", _parameters),
        Case("display curve", family, "from −0.5 to 1.5", "the standard's formula, there and back", _curve),
        Case("bf16 image", family, "8 bits of mantissa", "the nearest of 256 values", _image),
        Case("bf16 scores", family, "a sum of 1,000 exponentials", "log-odds as of float64", _scores),
        Case("bf16 network", family, "8 bits of mantissa", "float32 scores, as close as bf16 allows", _network),
        Case("seeds 0 and 2⁶³ − 1", family, "the ends of the range", "reproducible, and all different", _seeds),
        Case("seed −1", family, "below the range", refused, lambda: _refused(-1), "refused", "seed"),
        Case("seed 2⁶³", family, "above the range", refused, lambda: _refused(2**63), "refused", "seed"),
    ]
