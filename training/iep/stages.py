"""The training of IEP from nothing to its parts: data, trunk, features, engine, program generator.

Each stage goes on where it was, so that a training that is ended and begun again ends in the same bits.
"""

import hashlib
import io
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from scene_attack import disk
from scene_attack.errors import InvalidRequest
from scene_attack.rendering.color import from_bytes
from scene_attack.scenes.library import Library
from scene_attack_questions.iep.checkpoint import round_weights
from scene_attack_questions.iep.engine import Network, Trunk
from scene_attack_questions.iep.program_generator import ProgramGenerator
from training.iep.data import DataFolder, Images, Shard, examples_of, objects_of
from training.iep.engine_training import engine_step
from training.iep.generator_training import generator_step
from training.iep.recipe import Recipe, Split
from training.iep.trunk_training import AugmentedViews, ObjectFinder, hand_over, trunk_step
from training.loop import Report, Said, Schedule, Step, TrainingLoop


class Stages:
    """A training in a folder: `data/` has the shards, `features/` those of the finished trunk, and each part has a
    checkpoint."""

    def __init__(
        self,
        recipe: Recipe,
        seed: int,
        folder: Path,
        library: Library,
        said: Said,
        over: Callable[[], bool],
        processes: int = 1,
    ) -> None:
        """`over` is asked again and again whether to end early, with everything saved. `processes` draw the scenes."""
        self.recipe, self.seed = recipe, seed
        self.data = DataFolder(folder / "data", recipe, seed)
        self.seconds: dict[str, float] = {}
        self._folder, self._library, self._said, self._over = folder, library, said, over
        self._processes = processes
        torch.manual_seed(seed)
        self.finder, self.network, self.generator = ObjectFinder(), Network(), ProgramGenerator()
        # As images come: a quarter faster on a processor.
        self.finder.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def run(self) -> bool:
        """Goes through the stages until it is over; returns whether all are finished.

        `network` and `generator` then are the trained ones. Raises InvalidRequest("--out") for a file in the folder
        that is damaged or of another training.
        """
        return self._draw() and self._train_trunk() and self._train_engine() and self._train_generator()

    def _draw(self) -> bool:
        splits: tuple[Split, ...] = ("train", "validation", "test")
        return self.data.draw_missing(splits, self._library, self._said, self._over, self._processes)

    def _train_trunk(self) -> bool:
        recipe, data = self.recipe, self.data

        def step() -> Step:
            of = data.read_all("train")
            images, objects = Images(of), objects_of(of)
            return trunk_step(self.finder, AugmentedViews(images, objects), len(images), recipe.trunk_batch)

        if not self._train("trunk", self.finder, recipe.trunk, step, data.digest("train")):
            return False
        round_weights(self.finder.trunk.requires_grad_(False).eval())
        return write_features(self._features, self.finder.trunk, data, "train", self._said, self._over)

    def _train_engine(self) -> bool:
        recipe, data, engine = self.recipe, self.data, self.network.engine
        trunk = self.finder.trunk
        self.network.trunk.load_state_dict(trunk.state_dict())
        hand_over(self.finder, engine)

        def step() -> Step:
            of = data.read_all("train")
            examples, cells = list(examples_of(of)), [[truth.cell for truth in scene] for scene in objects_of(of)]
            inputs = read_features(self._features, data, "train")
            return engine_step(engine, inputs, examples, cells, recipe.engine_batch)

        return self._train("engine", engine, recipe.engine, step, digest_of(trunk))

    def _train_generator(self) -> bool:
        recipe, data = self.recipe, self.data

        def step() -> Step:
            return generator_step(self.generator, list(examples_of(data.read_all("train"))), recipe.generator_batch)

        return self._train("generator", self.generator, recipe.generator, step, data.digest("train"))

    def _train(self, name: str, module: nn.Module, schedule: Schedule, step: Callable[[], Step], data: str) -> bool:
        """Trains a part until it is finished or over; returns whether it is finished. A finished part needs no data."""
        path = self._folder / f"{name}.checkpoint"
        about = {"name": name, "schedule": asdict(schedule), "seed": self.seed, "data": data}
        loop = TrainingLoop(module, path, about, (self.seed,), schedule.decay, schedule.clip)

        def report(at: Report) -> None:
            losses = "  ".join(f"{part} {loss:.3f}" for part, loss in at.losses.items())
            self._said(f"training the {name}", at.step, schedule.steps, f"{losses}  {at.rate:.1f} steps/s")

        if loop.step < schedule.steps and not self._over():
            loop.run(schedule.progress, schedule.rate_at, step(), report, stop=lambda _: self._over())
            loop.save()
        self.seconds[name] = loop.seconds
        return loop.step >= schedule.steps

    @property
    def _features(self) -> Path:
        return self._folder / "features"


AT_ONCE = 20
"""Images that the trunk sees together."""


@torch.no_grad()
def features_of(trunk: Trunk, shard: Shard) -> Tensor:
    """Returns a frozen trunk's features of the images of a shard, [n, 96, 15, 20] in half precision."""
    images = Images([shard])
    batches = []
    for start in range(0, len(images), AT_ONCE):
        shown = images(range(start, min(start + AT_ONCE, len(images))))
        batches.append(trunk(from_bytes(torch.from_numpy(shown))).half())
    return torch.cat(batches).contiguous()


def digest_of(trunk: Trunk) -> str:
    """Returns the digest of a trunk's weights."""
    buffer = io.BytesIO()
    for value in trunk.state_dict().values():
        buffer.write(value.detach().contiguous().numpy().tobytes())
    return hashlib.sha256(buffer.getvalue()).hexdigest()


def write_features(
    folder: Path, trunk: Trunk, data: DataFolder, split: Split, said: Said, over: Callable[[], bool]
) -> bool:
    """Writes the features of a split's shards that are not there, until it is over; returns whether all are there."""
    pieces, about = data.pieces(split), digest_of(trunk)
    for number, piece in enumerate(pieces):
        path = folder / data.path(piece).name
        if path.exists() and _trunk_of(path) == about:
            continue
        if over():
            return False
        disk.write(path, save({"features": features_of(trunk, data.read(piece))}, {"trunk": about}))
        said("computing features", number + 1, len(pieces), "")
    return True


def read_features(folder: Path, data: DataFolder, split: Split) -> Tensor:
    """Returns the features of all images of a split, float16 [V, 96, 15, 20]."""
    shards = []
    for piece in data.pieces(split):
        with safe_open(folder / data.path(piece).name, framework="pt") as file:
            shards.append(file.get_tensor("features"))
    return torch.cat(shards)


def _trunk_of(path: Path) -> str:
    try:
        with safe_open(path, framework="pt") as file:
            return str((file.metadata() or {}).get("trunk"))
    except (SafetensorError, OSError) as error:
        raise InvalidRequest("--out", f"{path} is damaged ({error}); delete it, and it is made anew") from error
