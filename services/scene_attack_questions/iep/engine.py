"""The execution engine: runs a network assembled from modules over image features, level by level; and the whole
network θ(q), from images to the scores of the answers to questions about them.

The trunk is a small convolutional network from an image to the features that the modules read. The stem computes the
features that all modules see of an image, and `scene`, the mask of all objects.

The weights of all modules of a kind are one tensor, whose first axis is the module. A batch of calls of different
modules of a kind is then one batched product with the gathered weights. A map is a mask over the P cells of an image
that may hold an object: one logit for each, whether it holds the centre of one of the set.

Modules work at the cells that are likeliest to hold an object, as no set has a member elsewhere. A cell's weight falls
to zero before it drops out, so scores are a continuous function of the image.
"""

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import torch
from torch import Tensor, nn

from scene_attack_questions.executor import ANSWERS
from scene_attack_questions.iep.assembly import COMPARING, JOINING, MAPPED, MAPPING, READING, Assembly, Call, Slot

IMAGE = (240, 320)
"""Height and width of the images, in pixels."""
STRIDE = 16
"""Pixels of a feature cell's side."""
GRID = (IMAGE[0] // STRIDE, IMAGE[1] // STRIDE)
CHANNELS = 96
MEAN, SCALE = 0.5, 0.25
"""Normalisation of pixel values in [0,1]."""


class Convolution(nn.Sequential):
    """A convolution that keeps the size or divides it by its stride, batch normalisation, and optionally ReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1, relu: bool = True):
        convolution = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
        nn.init.kaiming_normal_(convolution.weight, mode="fan_out", nonlinearity="relu")
        super().__init__(convolution, nn.BatchNorm2d(outputs), *([nn.ReLU()] if relu else []))


class Block(nn.Module):
    """A residual block of two 3×3 convolutions."""

    def __init__(self, channels: int):
        super().__init__()
        self.first = Convolution(channels, channels, 3)
        self.second = Convolution(channels, channels, 3, relu=False)

    def forward(self, x: Tensor) -> Tensor:
        """Maps [B, channels, h, w] to the same shape."""
        y: Tensor = x + self.second(self.first(x))
        return y.relu()


class Trunk(nn.Module):
    """Maps images [B, 240, 320, 3] in [0,1] to features [B, 96, 15, 20]; 0.51 million parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            Convolution(3, 24, 5, 2),
            Convolution(24, 48, 3, 2),
            Block(48),
            Convolution(48, CHANNELS, 3, 2),
            Block(CHANNELS),
            Convolution(CHANNELS, CHANNELS, 3, 2),
            Block(CHANNELS),
        )

    def forward(self, images: Tensor) -> Tensor:
        """Maps images [B, 240, 320, 3] in [0,1] to features [B, 96, 15, 20]. Raises ValueError for another size."""
        if images.dim() != 4 or tuple(images.shape[1:]) != (*IMAGE, 3):
            raise ValueError(f"the trunk takes images [B, {IMAGE[0]}, {IMAGE[1]}, 3], not {list(images.shape)}")
        features: Tensor = self.layers((images.permute(0, 3, 1, 2) - MEAN) / SCALE)
        return features


WIDTH = 64
"""Channels of image features, of activations and of vectors inside the engine."""
LOGIT_SCALE = 8.0
"""Mask logits are divided by it where modules take them; it is the size of large ones."""
COORDINATE_FAN_IN = 16
"""Sets the size of the weights of coordinates before training, so that features outweigh them."""
FIRST_MASK = -3.0
"""Bias of the mask logits before training: few cells hold an object."""


class Seen(NamedTuple):
    """The features of images that modules see.

    features: [B, 66, P], image features and two coordinates. gate: [B, P] in [0,1], the weight of each cell.
    """

    features: Tensor
    gate: Tensor

    def product(self, rows: Tensor) -> Tensor:
        """Returns products [n, m, P] of `rows` [n, m, 66] with the features of n images, or of the only one."""
        return torch.bmm(rows, self.features) if len(self.features) > 1 else rows @ self.features[0]


class Maps(NamedTuple):
    """A stack of maps.

    logits: [n, P], of the mask. signals: [n, 2, P], the mask and its scaled logits, which are what modules take of it.
    weights: [n, P, 2], the mask and the softmax of its logits over the cells. looks and places: [n, 64, 1] and
    [n, 2, 1], features and coordinates averaged with that softmax: those of the object that is attended to.
    """

    logits: Tensor
    signals: Tensor
    weights: Tensor
    looks: Tensor
    places: Tensor


def attend(logits: Tensor, seen: Seen) -> Maps:
    """Returns maps with mask logits [n, P]; `seen` is of n images, or of one."""
    mask = logits.sigmoid() * seen.gate
    focus = (logits + seen.gate.clamp_min(torch.finfo(logits.dtype).tiny).log()).softmax(1)
    transposed = Seen(seen.features.transpose(1, 2), seen.gate)
    pooled = transposed.product(focus[:, None]).transpose(1, 2)
    signals = torch.stack([mask, logits / LOGIT_SCALE], dim=1)
    return Maps(logits, signals, torch.stack([mask, focus], dim=2), pooled[:, :WIDTH], pooled[:, WIDTH:])


def of(weights: Tensor, chosen: Tensor) -> Tensor:
    """Returns the weights of the chosen modules, int64 [n]."""
    return weights.index_select(0, chosen)


def random(modules: int, outputs: int, inputs: int, fan_in: int) -> nn.Parameter:
    """Returns weights [modules, outputs, inputs] of layers with ReLU; `fan_in` is the number of inputs of a sum."""
    return nn.Parameter(torch.randn(modules, outputs, inputs) * sqrt(2 / fan_in))


def constant(modules: int, outputs: int, value: float = 0.0) -> nn.Parameter:
    """Returns biases [modules, outputs, 1]."""
    return nn.Parameter(torch.full((modules, outputs, 1), value))


class FirstLayer(nn.Module):
    """The first layer of modules that take maps: 1×1 convolutions of the image's features, of coordinates, of the masks
    of the inputs, and of what each input attends to.

    Coordinates enter twice: as they are, and relative to the attended position. What is attended to also scales the
    weights of the features, so that a module can compare a cell with it.
    """

    def __init__(self, modules: int, inputs: int):
        super().__init__()
        fan_in = WIDTH * (1 + inputs)
        self.image = random(modules, WIDTH, WIDTH, fan_in)
        self.scaled = random(modules, WIDTH, WIDTH * inputs, fan_in)
        self.attended = random(modules, WIDTH, WIDTH * inputs, fan_in)
        self.masks = random(modules, WIDTH, 2 * inputs, 2 * inputs)
        self.absolute = random(modules, WIDTH, 2, COORDINATE_FAN_IN)
        self.relative = random(modules, WIDTH, 2 * inputs, COORDINATE_FAN_IN)
        self.bias = constant(modules, WIDTH)
        self.inputs = inputs

    def forward(self, chosen: Tensor, seen: Seen, inputs: Sequence[Maps]) -> Tensor:
        """Returns activations [n, 64, P] of stacks of n maps, one for each input.

        chosen: int64 [n], the modules. seen: of each call's image, or of the only one.
        """
        looks = torch.cat([maps.looks for maps in inputs], dim=1)
        places = torch.cat([maps.places for maps in inputs], dim=1)
        relative = of(self.relative, chosen)
        bias = torch.baddbmm(of(self.bias, chosen), of(self.attended, chosen), looks)
        bias = bias.baddbmm_(relative, places, alpha=-1)
        features = of(self.scaled, chosen) * looks.transpose(1, 2)
        features = features.view(-1, WIDTH, self.inputs, WIDTH).sum(2) + of(self.image, chosen)
        coordinates = relative.view(-1, WIDTH, self.inputs, 2).sum(2) + of(self.absolute, chosen)
        x = seen.product(torch.cat([features, coordinates], dim=2))
        ones = looks.new_ones(()).expand(len(chosen), 1, x.shape[2])
        signals = torch.cat([*(maps.signals for maps in inputs), ones], dim=1)
        return x.baddbmm_(torch.cat([of(self.masks, chosen), bias], dim=2), signals).relu_()


class MapModules(nn.Module):
    """Modules whose result is a map: a first layer, a residual block of two 1×1 convolutions, and a mask head."""

    def __init__(self, modules: int, inputs: int):
        super().__init__()
        self.first = FirstLayer(modules, inputs)
        self.second = random(modules, WIDTH, WIDTH, WIDTH)
        self.second_bias = constant(modules, WIDTH)
        self.third = random(modules, WIDTH, WIDTH, 4 * WIDTH)
        self.third_bias = constant(modules, WIDTH)
        self.mask = random(modules, 1, WIDTH, 4 * WIDTH)
        self.mask_bias = constant(modules, 1, FIRST_MASK)

    def forward(self, chosen: Tensor, seen: Seen, inputs: Sequence[Maps]) -> Maps:
        """Returns n maps; arguments as of `FirstLayer`."""
        x = self.first(chosen, seen, inputs)
        y = torch.bmm(of(self.second, chosen), x).add_(of(self.second_bias, chosen)).relu_()
        x = (x + of(self.third_bias, chosen)).baddbmm_(of(self.third, chosen), y).relu_()
        return attend(torch.bmm(of(self.mask, chosen), x).add_(of(self.mask_bias, chosen))[:, 0], seen)


class ReadingModules(nn.Module):
    """Modules from a map to a vector: a first layer, summed over the set and averaged over the cells that are attended
    to.
    """

    def __init__(self, modules: int):
        super().__init__()
        self.first = FirstLayer(modules, 1)
        self.second = random(modules, WIDTH, 2 * WIDTH, 2 * WIDTH)
        self.second_bias = constant(modules, WIDTH)

    def forward(self, chosen: Tensor, seen: Seen, inputs: Sequence[Maps]) -> Tensor:
        """Returns vectors [n, 64]; arguments as of `FirstLayer`."""
        x = self.first(chosen, seen, inputs)
        pooled = torch.bmm(x, inputs[0].weights).transpose(1, 2).flatten(1)[:, :, None]
        return torch.baddbmm(of(self.second_bias, chosen), of(self.second, chosen), pooled)[:, :, 0].relu()


class ComparingModules(nn.Module):
    """Modules from two vectors to a vector, by way of both vectors and of both distributions over the answers."""

    def __init__(self, modules: int, answers: int):
        super().__init__()
        inputs = 2 * WIDTH + 3 * answers
        self.first = random(modules, WIDTH, inputs, inputs)
        self.first_bias = constant(modules, WIDTH)
        self.second = random(modules, WIDTH, WIDTH, WIDTH)
        self.second_bias = constant(modules, WIDTH)

    def forward(self, chosen: Tensor, vectors: Sequence[Tensor], scores: Sequence[Tensor]) -> Tensor:
        """Returns vectors [n, 64] of two stacks of vectors [n, 64] with their scores [n, answers]."""
        first, second = (score.softmax(1) for score in scores)
        x = torch.cat([*vectors, first, second, first * second], dim=1)[:, :, None]
        x = torch.baddbmm(of(self.first_bias, chosen), of(self.first, chosen), x).relu()
        return torch.baddbmm(of(self.second_bias, chosen), of(self.second, chosen), x)[:, :, 0].relu()


N_CELLS = GRID[0] * GRID[1]


class Candidates(NamedTuple):
    """The results of the stem.

    scene: mask logits [B, 300] of all objects, at all cells. cells: int64 [B, P], the cells that modules work at. seen:
    the features there. logits: [B, P], those of `scene` there.
    """

    scene: Tensor
    cells: Tensor
    seen: Seen
    logits: Tensor


class Stem(nn.Module):
    """Maps features [B, 96, 15, 20] to the P = `cells` cells likeliest to hold an object; 300 are all of them."""

    grid: Tensor

    def __init__(self, cells: int):
        super().__init__()
        if not 0 < cells <= N_CELLS:
            raise ValueError(f"the engine works at 1 to {N_CELLS} cells, not {cells}")
        self.cells = cells
        self.mask = nn.Conv1d(CHANNELS, 1, 1)
        self.looks = nn.Conv1d(CHANNELS, WIDTH, 1)
        nn.init.kaiming_normal_(self.looks.weight, nonlinearity="relu")
        nn.init.constant_(self.mask.bias, FIRST_MASK)  # type: ignore[arg-type]
        self.register_buffer("grid", coordinates(), persistent=False)

    def forward(self, features: Tensor) -> Candidates:
        """Returns the candidates of images with features [B, 96, 15, 20]."""
        features = features.flatten(2)
        scene = self.mask(features)[:, 0]
        if self.cells < N_CELLS:
            likeliest = scene.topk(self.cells + 1, dim=1)
            cells, logits = likeliest.indices[:, :-1], likeliest.values[:, :-1]
            gate = (logits - likeliest.values[:, -1:]).tanh()
            features = features.gather(2, cells[:, None].expand(-1, CHANNELS, -1))
        else:
            cells = torch.arange(N_CELLS, device=scene.device).expand(len(scene), -1)
            logits, gate = scene, torch.ones_like(scene)
        coordinates = self.grid[:, cells].transpose(0, 1)
        seen = torch.cat([self.looks(features).relu(), coordinates], dim=1)
        return Candidates(scene, cells, Seen(seen, gate), logits)


def coordinates() -> Tensor:
    """Returns horizontal and vertical coordinates [2, 300] of the cells' centres, in half widths of the image."""
    height, width = GRID
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([2 * x + 1 - width, 2 * y + 1 - height]).flatten(1).float() / width


class Execution:
    """The results of an assembly on a batch of images."""

    def __init__(self, assembly: Assembly, candidates: Candidates, maps: Sequence[Maps], scores: Sequence[Tensor]):
        self.assembly = assembly
        self.candidates = candidates
        self._logits = [stack.logits for stack in maps]
        self._masks = [stack.weights for stack in maps]
        self._scores = scores

    @property
    def scores(self) -> Tensor:
        """The scores [Q, 28] of the answers to the questions."""
        return self.answer_scores([slots[-1] for slots in self.assembly.slots])

    def answer_scores(self, slots: Sequence[Slot]) -> Tensor:
        """Returns the scores [n, 28] of vectors: of roots, and of counts and queries inside a program."""
        return rows(self._scores, slots)

    def mask_logits(self, slots: Sequence[Slot]) -> Tensor:
        """Returns the logits [n, P] of the masks of maps, at the cells of `candidates.cells` of each one's image."""
        return rows(self._logits, slots)

    def attention(self, question: int, node: int) -> Tensor:
        """Returns the mask [15, 20] in [0,1] of a node of a question; a cell is high if an object of the set is there.

        Raises ValueError if the node's result is no set and no object.
        """
        program, slot = self.assembly.questions[question].program, self.assembly.slots[question][node]
        if program.types[node] not in MAPPED:
            raise ValueError(f"node {node} is {program.nodes[node].label}, which has no attention mask")
        mask = rows(self._masks, [slot])[0, :, 0]
        whole = mask.new_zeros(GRID[0] * GRID[1])
        return whole.scatter(0, self.candidates.cells[slot.image], mask).view(GRID)


def rows(stacks: Sequence[Tensor], slots: Sequence[Slot]) -> Tensor:
    """Returns the rows at `slots`, of which there is one at least, of stacks of results."""
    taken: dict[int, list[int]] = {}
    for place, slot in enumerate(slots):
        taken.setdefault(slot.stack, []).append(place)
    parts = [selected(stacks[stack], [slots[place].row for place in places]) for stack, places in taken.items()]
    if len(parts) == 1:
        return parts[0]
    order = {place: at for at, place in enumerate(place for places in taken.values() for place in places)}
    return selected(torch.cat(parts), [order[place] for place in range(len(slots))])


def map_inputs(stacks: Sequence[Maps], calls: Sequence[Call]) -> list[Maps]:
    """Returns for each input of calls the stack of its maps, a row for each call."""
    fields = list(zip(*stacks, strict=True))
    inputs = zip(*(call.inputs for call in calls), strict=True)
    return [Maps(*(rows(field, slots) for field in fields)) for slots in inputs]


def vector_inputs(stacks: Sequence[Tensor], calls: Sequence[Call]) -> list[Tensor]:
    """Returns for each input of calls the stack of its vectors, a row for each call."""
    return [rows(stacks, slots) for slots in zip(*(call.inputs for call in calls), strict=True)]


def selected(stack: Tensor, places: Sequence[int]) -> Tensor:
    """Returns the rows of a stack at some places; the stack itself, and no copy, if these are all, in order."""
    return stack if list(places) == list(range(len(stack))) else stack.index_select(0, long(places, stack))


def joined(parts: Sequence[Tensor]) -> Tensor:
    """Returns the concatenation of tensors; a single one itself, and no copy."""
    return parts[0] if len(parts) == 1 else torch.cat(list(parts))


def long(values: Sequence[int], like: Tensor) -> Tensor:
    """Returns integers as int64 on the device of another tensor."""
    return torch.tensor(values, dtype=torch.int64, device=like.device)


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
    """Returns the features of the image of each call; those of the only image if there is one only."""
    return seen if len(seen.gate) == 1 else Seen(*(selected(field, [call.image for call in calls]) for field in seen))


def places(calls: Sequence[Call], like: Tensor) -> Tensor:
    """Returns the places of calls' modules in the lists of their kind, int64 [n]."""
    return long([call.place for call in calls], like)


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
