"""Which pixels of a looked-up image are summed as well, to see whether the table still holds.

No bound of a table's error is known that is cheap and tight: an attack takes normals, light and material to where the
table was not measured. So the error is sampled, in every image, where it is likely to be largest: a third of the pixels
have the largest fourth differences of the table around their normal, a third the largest second differences, both
times the steepness of the display's curve; the last third are spread evenly over the object, from a start that changes
with the image. The choice depends on the image alone, so that an attack that is resumed chooses the same pixels.
"""

import torch
from torch import Tensor

from services.rendering.color import KNEE
from services.rendering.kernels import compiled
from services.rendering.torch_renderer.lookup_table import nearest, unevenness


def chosen_pixels(
    most: int, table: Tensor, filled: Tensor, rows: int, angles: Tensor, shaded: Tensor, base_color: Tensor
) -> Tensor:
    """Indices of at most `most` of the pixels, ascending; all of them where there are no more.

    table [nodes, 3] of `rows` rows with its `filled` tiles [tiles]; angles [P, 2]; shaded [P, 3], the looked-up
    radiance; base_color [P, 3].
    """
    count = len(angles)
    if count <= most:
        return torch.arange(count, device=angles.device)
    third = most // 3
    uneven = unevenness(table, filled)
    if compiled.runs(angles):
        chosen, number = torch.empty(most, dtype=torch.int64), torch.empty(1, dtype=torch.int64)
        image = (uneven, *(of.detach().contiguous() for of in (angles, shaded, base_color)))
        sizes = (most, third, count, rows, KNEE)
        compiled.call("choose_pixels", angles.dtype, *sizes, *image, chosen, number, compiled.threads())
        return chosen[: int(number)]
    linear = (shaded.detach() * base_color).clamp_(0.0, 1.0)
    steepness = (base_color * linear.add_(KNEE).rsqrt_()).amax(1)  # near enough to put pixels in order
    likely = uneven[:, nearest(angles.detach(), rows)] * steepness
    stride = count // (most - 2 * third)
    even = torch.arange(_start(shaded) % stride, count, stride, device=angles.device)[: most - 2 * third]
    found: Tensor = torch.unique(torch.cat([*likely.topk(third).indices, even]))
    return found


def _start(shaded: Tensor) -> int:
    """A number that changes with the image: the sum of its bits, which no order of summing changes."""
    bits = torch.int32 if shaded.dtype == torch.float32 else torch.int64
    return int(shaded.detach().contiguous().view(bits).sum(dtype=torch.int64))
