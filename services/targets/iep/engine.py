"""The execution engine: runs a network assembled from modules over image features, level by level."""

from collections.abc import Sequence

from torch import Tensor, nn

from services.questions.answers import ANSWERS
from services.targets.iep.assembly import Assembly, Call
from services.targets.iep.execution import Execution, joined, long, map_inputs, selected, vector_inputs
from services.targets.iep.modules import WIDTH, ComparingModules, MapModules, Maps, ReadingModules, Seen, attend
from services.targets.iep.stem import Stem
from services.targets.iep.trunk import CHANNELS, GRID
from services.targets.iep.vocabulary import COMPARING, JOINING, MAPPING, READING

CELLS = 64
"""Cells that the modules work at; there are at most ten objects."""


class Engine(nn.Module):
    """The modules, the stem that they share, and the classifier over the answers; 0.81 million parameters."""

    def __init__(self, cells: int = CELLS) -> None:
        super().__init__()
        self.stem = Stem(cells)
        self.mapping = MapModules(len(MAPPING), 1)
        self.joining = MapModules(len(JOINING), 2)
        self.reading = ReadingModules(len(READING))
        self.comparing = ComparingModules(len(COMPARING), len(ANSWERS))
        self.classifier = nn.Sequential(nn.Linear(WIDTH, 2 * WIDTH), nn.ReLU(), nn.Linear(2 * WIDTH, len(ANSWERS)))

    def forward(self, features: Tensor, assembly: Assembly) -> Execution:
        """Runs an assembly over features [B, 96, 15, 20] of the images that its questions are about.

        Raises ValueError for features of another shape or of too few images.
        """
        if features.dim() != 4 or tuple(features.shape[1:]) != (CHANNELS, *GRID) or len(features) < assembly.n_images:
            raise ValueError(f"features {list(features.shape)} are not those of {assembly.n_images} images")
        candidates = self.stem(features)
        seen = candidates.seen
        maps = [attend(candidates.logits, seen)]
        vectors: list[Tensor] = []
        scores: list[Tensor] = []
        for level in assembly.levels:
            new_maps = [
                modules(places(calls, seen.gate), of_images(seen, calls), map_inputs(maps, calls))
                for modules, calls in ((self.mapping, level.mapping), (self.joining, level.joining))
                if calls
            ]
            new_vectors: list[Tensor] = []
            if calls := level.reading:
                taken = map_inputs(maps, calls)
                new_vectors.append(self.reading(places(calls, seen.gate), of_images(seen, calls), taken))
            if calls := level.comparing:
                both = vector_inputs(vectors, calls), vector_inputs(scores, calls)
                new_vectors.append(self.comparing(places(calls, seen.gate), *both))
            if new_maps:
                maps.append(Maps(*(joined(field) for field in zip(*new_maps, strict=True))))
            if new_vectors:
                vectors.append(joined(new_vectors))
                scores.append(self.classifier(vectors[-1]))
        return Execution(assembly, candidates, maps, scores)


def of_images(seen: Seen, calls: Sequence[Call]) -> Seen:
    """Returns what is seen of the image of each call; what is seen of the only image if there is one only."""
    return seen if len(seen.gate) == 1 else Seen(*(selected(field, [call.image for call in calls]) for field in seen))


def places(calls: Sequence[Call], like: Tensor) -> Tensor:
    """Returns the places of calls' modules in the lists of their kind, int64 [n]."""
    return long([call.place for call in calls], like)
