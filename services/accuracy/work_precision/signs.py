"""Signs of gradients: what a step of FGSM takes from them."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class WrongSigns:
    """share: part of the coordinates whose sign is wrong. weight: part of the gradient's absolute sum that they hold; a
    step by the signs then gains 1 − 2 · weight of what it gains with the right ones."""

    share: float
    weight: float


def wrong_signs(found: Tensor, wanted: Tensor) -> WrongSigns:
    """Of estimates [..., n] of a gradient [n], over all coordinates that are not 0 in both.

    The sign of 0 is 0: a coordinate that is estimated as 0 and is not is wrong, and so is the converse, which weighs
    nothing.
    """
    wanted = wanted.expand_as(found)
    counted = (found != 0) | (wanted != 0)
    wrong = (found.sign() != wanted.sign()) & counted
    size, total = wanted.abs().double(), float(wanted.abs().double().sum())
    return WrongSigns(
        share=float(wrong.sum()) / max(1, int(counted.sum())),
        weight=float(size[wrong].sum()) / total if total else 0.0,
    )
