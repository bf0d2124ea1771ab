"""The file of a converted network: safetensors with the weights of trunk, engine and program generator.

Weights have the published names below `trunk.`, `engine.` and `generator.`; a function's module is in
`engine.functions.`. Sizes follow from their shapes. The metadata has the vocabulary.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path

from safetensors.torch import save
from torch import Tensor, nn

from services.errors import summary
from services.targets.architectures import fill_by_name
from services.targets.iep_released.engine import Engine
from services.targets.iep_released.generator import ProgramGenerator
from services.targets.iep_released.trunk import STAGES, Trunk
from services.targets.iep_released.vocabulary import Vocabulary
from services.targets.weights_file import read

State = Mapping[str, Tensor]


@dataclass(frozen=True)
class Released:
    """A released network, in evaluation and without gradients of weights."""

    trunk: Trunk
    engine: Engine
    generator: ProgramGenerator
    vocabulary: Vocabulary


def build(trunk: State, engine: State, generator: State, vocabulary: Vocabulary) -> Released:
    """Returns the network of these weights. Raises ValueError, which names the first that is missing or does not fit.

    Weights are named as in the file, without the name of the part.
    """
    try:
        _check_sizes(trunk, engine, generator, vocabulary)
        made = Released(_trunk(trunk), _engine(engine), _generator(generator), vocabulary)
    except KeyError as error:
        raise ValueError(f"it lacks {error.args[0]}") from error
    for name, module, state in (
        ("trunk", made.trunk, trunk),
        ("engine", made.engine, engine),
        ("generator", made.generator, generator),
    ):
        try:
            fill_by_name(module, state)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
        module.requires_grad_(False).eval()
    return made


def to_bytes(network: Released) -> bytes:
    """Returns the file of a network."""
    parts: dict[str, nn.Module] = {
        "trunk": network.trunk,
        "engine": network.engine,
        "generator": network.generator,
    }
    tensors = {f"{part}.{name}": value for part, of in parts.items() for name, value in of.state_dict().items()}
    # One entry, as several would be in any order: the same network gives the same bytes.
    return save(tensors, {"vocabulary": json.dumps(asdict(network.vocabulary))})


def load(path: Path) -> Released:
    """Reads the file of a network. Raises ValueError, which says why, if it is none."""
    tensors, metadata = read(path)
    try:
        vocabulary = Vocabulary(**{kind: tuple(of) for kind, of in json.loads(metadata["vocabulary"]).items()})
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"its metadata has no vocabulary: {summary(error)}") from error
    parts = {part: _below(f"{part}.", tensors) for part in ("trunk", "engine", "generator")}
    return build(**parts, vocabulary=vocabulary)


def _below(prefix: str, tensors: State) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _shape(state: State, name: str, dimensions: int) -> tuple[int, ...]:
    """The shape of a weight. Raises ValueError for other dimensions, and KeyError if there is no such weight."""
    shape = tuple(state[name].shape)
    if len(shape) != dimensions or 0 in shape:
        raise ValueError(f"{name} has the shape {list(shape)}; one of {dimensions} dimensions above 0 is due")
    return shape


def _trunk(state: State) -> Trunk:
    return Trunk(_shape(state, "conv1.weight", 4)[0], [_blocks(state, f"layer{k}") for k in range(1, STAGES + 1)])


def _blocks(state: State, stage: str) -> int:
    return next(k for k in count() if f"{stage}.{k}.conv1.weight" not in state)


def _engine(state: State) -> Engine:
    width, features = _shape(state, "stem.0.weight", 4)[:2]
    hidden, pooled = _shape(state, "classifier.4.weight", 2)
    projection, answers = _shape(state, "classifier.0.weight", 4)[0], _shape(state, "classifier.6.weight", 2)[0]
    return Engine(features, width, projection, pooled, hidden, answers)


def _generator(state: State) -> ProgramGenerator:
    words, embedding = _shape(state, "encoder_embed.weight", 2)
    functions, hidden = _shape(state, "decoder_embed.weight", 2)[0], _shape(state, "decoder_linear.weight", 2)[1]
    layers = next(k for k in count() if f"encoder_rnn.weight_ih_l{k}" not in state)
    return ProgramGenerator(words, functions, embedding, hidden, layers)


def _check_sizes(trunk: State, engine: State, generator: State, vocabulary: Vocabulary) -> None:
    """Raises ValueError if parts do not fit together, and KeyError for a weight that is missing."""
    pairs = {
        "features": (_shape(trunk, f"layer{STAGES}.0.conv3.weight", 4)[0], _shape(engine, "stem.0.weight", 4)[1]),
        "words": (_shape(generator, "encoder_embed.weight", 2)[0], len(vocabulary.words)),
        "functions": (_shape(generator, "decoder_embed.weight", 2)[0], len(vocabulary.functions)),
        "answers": (_shape(engine, "classifier.6.weight", 2)[0], len(vocabulary.answers)),
    }
    for name, (one, other) in pairs.items():
        if one != other:
            raise ValueError(f"its parts do not fit together: they have {one} and {other} {name}")
