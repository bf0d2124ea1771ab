"""Checkpoints with random weights as clevr-iep's own scripts and torchvision write them: names, shapes, vocabulary.

Nothing here is shared with the code that is tested. Widths are small; all else is as published.
"""

import io
import pickle
import struct
import sys
from collections import OrderedDict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

BASE, BLOCKS = 4, (1, 2, 2)
"""Channels of the trunk's first stage, and its blocks; published are 64, and 3, 4 and 23."""
FEATURES, WIDTH, PROJECTION, HIDDEN = 16 * BASE, 8, 6, 10
"""Published are 1024, 128, 512 and 1024."""
EMBEDDING, STATE, LAYERS = 12, 24, 2
"""Published are 300, 256 and 2."""
SPECIAL = ("<NULL>", "<START>", "<END>", "<UNK>")
VALUES = {
    "color": ("blue", "brown", "cyan", "gray", "green", "purple", "red", "yellow"),
    "material": ("metal", "rubber"),
    "shape": ("cube", "cylinder", "sphere"),
    "size": ("large", "small"),
}
BINARY = ("equal_color", "equal_integer", "equal_material", "equal_shape", "equal_size")
BINARY = (*BINARY, "greater_than", "intersect", "less_than", "union")
UNARY = ("count", "exist", "scene", "unique", *(f"{verb}_{name}" for verb in ("query", "same") for name in VALUES))
UNARY = (*UNARY, *(f"relate[{way}]" for way in ("behind", "front", "left", "right")))
UNARY = (*UNARY, *(f"filter_{name}[{value}]" for name, values in VALUES.items() for value in values))
ANSWERS = sorted(["yes", "no", *map(str, range(11)), *(value for values in VALUES.values() for value in values)])
QUESTIONS = {
    "How many cubes are there?": ("count", "filter_shape[cube]", "scene"),
    "Is the sphere red; yes, or no?": ("exist", "filter_color[red]", "filter_shape[sphere]", "scene"),
}
"""Questions that the generator knows, with their programs in prefix order."""


def vocab() -> dict[str, dict[Any, Any]]:
    """The vocabulary: tokens in alphabetical order after the special ones, in both directions."""
    texts = [text.replace(";", " ;").replace(",", " ,").replace("?", "").split(" ") for text in QUESTIONS]
    lists = {"question": sorted({word for text in texts for word in text}), "program": sorted((*BINARY, *UNARY))}
    lists["answer"] = ANSWERS
    made: dict[str, dict[Any, Any]] = {}
    for kind, tokens in lists.items():
        numbers = {token: number for number, token in enumerate((*SPECIAL, *tokens))}
        made |= {f"{kind}_token_to_idx": numbers, f"{kind}_idx_to_token": {n: token for token, n in numbers.items()}}
    return made


def trunk(seed: int = 0) -> dict[str, Tensor]:
    """A state dict of a ResNet with bottlenecks, with its last stage and its classifier."""
    state: dict[str, Tensor] = OrderedDict()
    random = torch.Generator().manual_seed(seed)

    def normalised(name: str, number: str, inputs: int, outputs: int, kernel: int) -> None:
        bn = f"{name}downsample.1" if number == "downsample" else f"{name}bn{number}"
        conv = f"{name}downsample.0" if number == "downsample" else f"{name}conv{number}"
        state[f"{conv}.weight"] = torch.randn(outputs, inputs, kernel, kernel, generator=random) / kernel / inputs**0.5
        for kind in ("weight", "running_var"):
            state[f"{bn}.{kind}"] = 0.5 + torch.rand(outputs, generator=random)
        for kind in ("bias", "running_mean"):
            state[f"{bn}.{kind}"] = 0.1 * torch.randn(outputs, generator=random)

    normalised("", "1", 3, BASE, 7)
    inputs = BASE
    for stage, blocks in enumerate((*BLOCKS, 1)):
        width = BASE * 2**stage
        for block in range(blocks):
            name = f"layer{stage + 1}.{block}."
            normalised(name, "1", inputs, width, 1)
            normalised(name, "2", width, width, 3)
            normalised(name, "3", width, 4 * width, 1)
            if block == 0:
                normalised(name, "downsample", inputs, 4 * width, 1)
            inputs = 4 * width
    return state | {"fc.weight": torch.randn(5, inputs, generator=random), "fc.bias": torch.zeros(5)}


def engine(seed: int = 1) -> dict[str, Any]:
    """A checkpoint of an execution engine."""
    random = torch.Generator().manual_seed(seed)
    state: dict[str, Tensor] = OrderedDict()

    def layer(name: str, *shape: int) -> None:
        state[f"{name}.weight"] = torch.randn(shape, generator=random) / _fan(shape)
        state[f"{name}.bias"] = 0.1 * torch.randn(shape[0], generator=random)

    layer("stem.0", WIDTH, FEATURES, 3, 3)
    layer("stem.2", WIDTH, WIDTH, 3, 3)
    layer("classifier.0", PROJECTION, WIDTH, 1, 1)
    layer("classifier.4", HIDDEN, PROJECTION * 7 * 7)
    layer("classifier.6", len(SPECIAL) + len(ANSWERS), HIDDEN)
    for token in (*SPECIAL, *BINARY, *UNARY):
        inside = f"{token}.res_block" if token in BINARY else token
        if token in BINARY:
            layer(f"{token}.proj", WIDTH, 2 * WIDTH, 1, 1)
        layer(f"{inside}.conv1", WIDTH, WIDTH, 3, 3)
        layer(f"{inside}.conv2", WIDTH, WIDTH, 3, 3)
    settings = {
        "vocab": vocab(),
        "feature_dim": (FEATURES, 14, 14),
        "stem_batchnorm": False,
        "stem_num_layers": 2,
        "module_dim": WIDTH,
        "module_residual": True,
        "module_batchnorm": False,
        "classifier_batchnorm": False,
        "classifier_proj_dim": PROJECTION,
        "classifier_downsample": "maxpool2",
        "classifier_fc_layers": (HIDDEN,),
        "classifier_dropout": 0.0,
    }
    return _checkpoint(execution_engine_state=state, execution_engine_kwargs=settings)


def _fan(shape: tuple[int, ...]) -> float:
    return float(torch.Size(shape[1:]).numel()) ** 0.5


class Seq2Seq(nn.Module):
    """The program generator."""

    def __init__(self, words: int, functions: int):
        super().__init__()
        self.encoder_embed = nn.Embedding(words, EMBEDDING)
        self.encoder_rnn = nn.LSTM(EMBEDDING, STATE, LAYERS, batch_first=True)
        self.decoder_embed = nn.Embedding(functions, EMBEDDING)
        self.decoder_rnn = nn.LSTM(EMBEDDING + STATE, STATE, LAYERS, batch_first=True)
        self.decoder_linear = nn.Linear(STATE, functions)

    def states(self, question: Tensor, program: Tensor) -> Tensor:
        """The decoder's states [S - 1, STATE] from which each token after the first is scored, given those before."""
        read = self.encoder_rnn(self.encoder_embed(question))[0][:, -1:]
        taken = torch.cat([read.expand(-1, program.shape[1] - 1, -1), self.decoder_embed(program[:, :-1])], 2)
        states: Tensor = self.decoder_rnn(taken)[0][0]
        return states


@torch.no_grad()
def generator(taught: bool = True) -> dict[str, Any]:
    """A checkpoint of a program generator. If it was taught, it knows QUESTIONS.

    Its LSTMs are random. The last layer has more inputs than the programs have tokens, so that the weights that score
    exactly the right tokens solve a linear system.
    """
    numbers = vocab()
    words, functions = numbers["question_token_to_idx"], numbers["program_token_to_idx"]
    torch.manual_seed(2)
    made = Seq2Seq(len(words), len(functions))
    for parameter in made.parameters():
        parameter *= 3  # so that states differ by what was read
    states, right = [], []
    for text, program in QUESTIONS.items():
        asked = ["<START>", *text.replace(";", " ;").replace(",", " ,").replace("?", "").split(" "), "<END>"]
        tokens = torch.tensor([[functions[token] for token in ("<START>", *program, "<END>")]])
        states.append(made.states(torch.tensor([[words[word] for word in asked]]), tokens).double())
        right.append(10.0 * F.one_hot(tokens[0, 1:], len(functions)).double())
    if taught:
        made.decoder_linear.weight.copy_((torch.linalg.pinv(torch.cat(states)) @ torch.cat(right)).T)
        made.decoder_linear.bias.zero_()
    state = OrderedDict((name, value.detach().clone()) for name, value in made.state_dict().items())
    settings = {
        "encoder_vocab_size": len(words),
        "decoder_vocab_size": len(functions),
        "wordvec_dim": EMBEDDING,
        "hidden_dim": STATE,
        "rnn_num_layers": LAYERS,
        "rnn_dropout": 0.0,
    }
    return _checkpoint(program_generator_state=state, program_generator_kwargs=settings)


def _checkpoint(**parts: Any) -> dict[str, Any]:
    """What the training script saves; the parts that were not trained are None."""
    names = ("program_generator", "execution_engine", "baseline")
    none = {f"{name}_{kind}": None for name in names for kind in ("kwargs", "state")}
    told = {"args": {"model_type": "EE", "learning_rate": 5e-4}, "baseline_type": None, "train_losses": [3.4, 0.1]}
    return none | {**told, "best_val_acc": 0.9, "model_t": 10, "vocab": vocab()} | parts


class _Pickler(pickle.Pickler):
    """Writes tensors as torch 0.1.11 did: a storage is a persistent id of five fields and None, its place is a GPU."""

    def persistent_id(self, one: object) -> object:
        if isinstance(one, _Storage):
            return "storage", torch.FloatStorage, one.key, "cuda:0", one.tensor.numel(), None
        return None

    def reducer_override(self, one: object) -> Any:
        if isinstance(one, Tensor):
            storage = self.storages.setdefault(id(one), _Storage(str(id(one)), one))
            return rebuild, (storage, 0, tuple(one.shape), one.contiguous().stride())
        return NotImplemented

    storages: "dict[int, _Storage]"


def rebuild(*_: object) -> None:
    """Stands for torch's own function, whose name is in the file."""
    raise AssertionError


class _Storage:
    def __init__(self, key: str, tensor: Tensor):
        self.key, self.tensor = key, tensor


def save_as_in_2017(made: object, path: Path) -> None:
    """Writes the file of torch 0.1.11: pickles of a magic number, a version, the machine, the object and the storages'
    keys, and then each storage's length and numbers."""
    with path.open("wb") as file:
        machine = {"protocol_version": 1001, "little_endian": True, "type_sizes": {"short": 2, "int": 4, "long": 4}}
        for head in (0x1950A86A20F9469CFC6C, 1001, machine):
            pickle.dump(head, file, protocol=2)
        buffer = io.BytesIO()
        pickler = _Pickler(buffer, protocol=2)
        pickler.storages = {}
        pickler.dump(made)
        file.write(buffer.getvalue().replace(f"c{__name__}\nrebuild\n".encode(), b"ctorch._utils\n_rebuild_tensor\n"))
        by_key = {one.key: one.tensor for one in pickler.storages.values()}
        keys = sorted(by_key)
        pickle.dump(keys, file, protocol=2)
        assert sys.byteorder == "little"
        for key in keys:
            numbers = by_key[key].contiguous()
            file.write(struct.pack("<q", numbers.numel()) + numbers.numpy().tobytes())
