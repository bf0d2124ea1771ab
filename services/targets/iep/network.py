"""The whole network θ(q): from images to the scores of the answers to questions about them."""

from torch import Tensor, nn

from services.targets.iep.assembly import Assembly
from services.targets.iep.engine import CELLS, Engine
from services.targets.iep.execution import Execution
from services.targets.iep.trunk import Trunk


class Network(nn.Module):
    """Trunk and engine. In evaluation the scores of a question do not depend on the other questions and images."""

    def __init__(self, cells: int = CELLS) -> None:
        super().__init__()
        self.trunk = Trunk()
        self.engine = Engine(cells)

    def forward(self, images: Tensor, assembly: Assembly) -> Execution:
        """Runs an assembly on the images [B, 240, 320, 3] in [0,1] that its questions are about."""
        execution: Execution = self.engine(self.trunk(images), assembly)
        return execution
