"""Eight bits of mantissa, and seeds at the ends of their range."""

import hashlib

import numpy as np
import torch
from pydantic import TypeAdapter, ValidationError

from services.accuracy.placing import placed, sky
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.linear import SIDE, linear_network
from services.attacks.goal import ResolvedGoal
from services.attacks.seeds import generator
from services.attacks.spec import LARGEST_SEED, Seed
from services.errors import InvalidRequest
from services.rendering.color import as_saved
from services.rendering.factory import build
from services.rendering.image_renderer import ImageRenderer


def _parameters() -> Measured:
    """Parameters in bfloat16 are those numbers, no worse: the image is computed in the renderer's own type."""
    renderer = build(placed(radiance=sky()), "torch")
    short = {g: v.to(torch.bfloat16)[None] for g, v in renderer.initial().items()}
    with torch.no_grad():
        first, second = renderer.render(short), renderer.render({g: v.float() for g, v in short.items()})
    need(first.dtype == torch.float32, f"the image is {first.dtype}")
    need(float(first.std()) > 0.01, "the image shows nothing")
    return Measured(
        float((first - second).abs().max()), 0.0, "difference from the image of the same numbers in float32"
    )


def _image() -> Measured:
    """An image in bfloat16 is saved as the 8 bits nearest to what it holds."""
    values = torch.linspace(0, 1, 4096).to(torch.bfloat16)
    wanted = torch.from_numpy(np.rint(values.double().numpy() * 255) / 255)
    shown = ImageRenderer(values.reshape(64, 64, 1).expand(-1, -1, 3), "numbers").initial()["image"]
    need(shown.dtype == torch.float32, f"the image is {shown.dtype}")
    return Measured(
        float((as_saved(values).double() - wanted).abs().max()), 1e-7, "difference from rounding in float64"
    )


def _scores() -> Measured:
    """Log-odds of bfloat16 scores lose nothing more: sums of exponentials are not taken in bfloat16."""
    scores = torch.randn(20, 1000, generator=torch.Generator().manual_seed(4)).to(torch.bfloat16)
    goal = ResolvedGoal(7, None)
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
        Case("bf16 image", family, "8 bits of mantissa", "the nearest of 256 values", _image),
        Case("bf16 scores", family, "a sum of 1,000 exponentials", "log-odds as of float64", _scores),
        Case("bf16 network", family, "8 bits of mantissa", "float32 scores, as close as bf16 allows", _network),
        Case("seeds 0 and 2⁶³ − 1", family, "the ends of the range", "reproducible, and all different", _seeds),
        Case("seed −1", family, "below the range", refused, lambda: _refused(-1), "refused", "seed"),
        Case("seed 2⁶³", family, "above the range", refused, lambda: _refused(2**63), "refused", "seed"),
    ]
