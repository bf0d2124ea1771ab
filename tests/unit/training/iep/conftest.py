"""Small worlds as training data: features of a perfect trunk, and questions with the true results of their programs."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

import pytest
import torch
from torch import Tensor

from scene_attack.scenes.library import Library
from scene_attack_questions.iep.program_generator import TOKENS
from scene_attack_questions.program import Node
from scene_attack_questions.text import WORDS
from tests.unit.questions.iep import world
from tests.unit.training.iep.small import stages
from training.iep.examples import Example
from training.iep.stages import Stages


@dataclass(frozen=True)
class Data:
    """features: [V, 96, 15, 20]. cells: for each image those of its objects."""

    features: Tensor
    cells: list[list[int]]
    examples: list[Example]


def data(seed: int, scenes: int, families: tuple[str, ...] = world.FAMILIES, per_scene: int = 8) -> Data:
    random = Random(seed)
    features, cells, examples = [], [], []
    for image in range(scenes):
        things = world.scene(random)
        features.append(world.features(things, seed=random.randrange(2**31)))
        cells.append([thing.cell for thing in things])
        for number in range(per_scene):
            family = families[number % len(families)]
            program, results = world.question(random, things, family)
            true = tuple(one if isinstance(one, tuple) else world.word(one) for one in results)
            examples.append(Example(image, _said(program.nodes), program, true, family))
    return Data(torch.stack(features), cells, examples)


def _said(nodes: tuple[Node, ...]) -> str:
    """A language without ambiguity: a word for each function and value, from the first node to the last."""
    return " ".join(WORDS[TOKENS.index(node.label)] for node in nodes)


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Sums of small matrices are then in the same order on every machine, and threads do not wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def simple() -> tuple[Data, Data]:
    """Filters with count and exist: to train on, and to test on."""
    families = ("count", "exist")
    return data(1, 300, families), data(2, 40, families)


@pytest.fixture(scope="session")
def mixed() -> Data:
    return data(3, 40)


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("training") / "iep"


@pytest.fixture(scope="session")
def whole(folder: Path, library: Library) -> Stages:
    """A finished training of `small.RECIPE` in `folder`."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    made = stages(folder, library)
    assert made.run()
    torch.set_num_threads(before)
    return made


@pytest.fixture
def copied(whole: Stages, folder: Path, tmp_path: Path) -> Path:
    """A folder with what `whole` left in `folder`."""
    assert set(whole.seconds) == {"trunk", "engine", "generator"}
    shutil.copytree(folder, tmp_path / "iep")
    return tmp_path / "iep"
