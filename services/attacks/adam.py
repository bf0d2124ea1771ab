"""Adam (Kingma & Ba 2015) on all attacked groups as one vector, for methods that estimate a gradient."""

from torch import Tensor

BETAS = (0.9, 0.999)
SMALLEST_DENOMINATOR = 1e-12


class Adam:
    """Adam's moments, float64 [total], and the learning rate of each coordinate, float64 [total]."""

    def __init__(self, rates: Tensor) -> None:
        self.rates = rates
        self.first = rates.new_zeros(rates.shape)
        self.second = rates.new_zeros(rates.shape)

    def change(self, gradient: Tensor, step: int) -> Tensor:
        """Takes in a gradient, float64 [total]. Returns the change that lowers the objective, float64 [total].

        `step` counts the gradients before this one.
        """
        self.first = BETAS[0] * self.first + (1 - BETAS[0]) * gradient
        self.second = BETAS[1] * self.second + (1 - BETAS[1]) * gradient.square()
        first, second = self.first / (1 - BETAS[0] ** (step + 1)), self.second / (1 - BETAS[1] ** (step + 1))
        return -self.rates * first / (second.sqrt() + SMALLEST_DENOMINATOR)

    def state(self) -> dict[str, Tensor]:
        """The moments."""
        return {"first": self.first, "second": self.second}

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`, which may be part of a larger dictionary."""
        self.first, self.second = state["first"], state["second"]
