"""The data of a recipe, made where they are missing: shards of images of scenes, which are drawn as they are or varied
as attacks vary them, with the scenes and questions in CLEVR's own formats.
"""

import hashlib
import io
import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import accumulate
from math import exp, pi
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy
from numpy.typing import NDArray
from PIL import Image
from safetensors import SafetensorError, safe_open
from torch import Tensor

from scene_attack import disk
from scene_attack.errors import InvalidRequest
from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.factory import build
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.clevr.records import Info, SceneFile, SceneRecord
from scene_attack_questions.executor import Facts
from scene_attack_questions.generator import QuestionFile, QuestionGenerator, QuestionRecord
from training.iep.examples import Example, ObjectTruth
from training.iep.processes import each
from training.iep.recipe import SHARD, Part, Recipe, Split
from training.loop import Said

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class Shard:
    """Some scenes, their images and their questions.

    png: uint8, the files of the images behind each other. ends: int64, where each ends. written: the JSON of scenes and
    questions.
    """

    png: Bytes
    ends: NDArray[np.int64]
    written: dict[str, str]

    def __len__(self) -> int:
        return len(self.ends)

    @cached_property
    def scenes(self) -> tuple[SceneRecord, ...]:
        """The scenes."""
        return SceneFile.model_validate_json(self.written["scenes"]).scenes

    @cached_property
    def questions(self) -> tuple[QuestionRecord, ...]:
        """The questions about all scenes; the scenes' own `image_index` tells them apart."""
        return QuestionFile.model_validate_json(self.written["questions"]).questions

    def image(self, number: int) -> Bytes:
        """Returns the image of a scene, uint8 [240, 320, 3]."""
        start = int(self.ends[number - 1]) if number else 0
        with Image.open(io.BytesIO(self.png[start : self.ends[number]].tobytes())) as file:
            return np.asarray(file)


VERSION = 1
"""Version of the drawn data. Raise it with every change of the drawing, so that older data is not taken for new."""


@dataclass(frozen=True)
class Piece:
    """The scenes of a shard: `count` of a part, from index `start` on."""

    part: Part
    start: int
    count: int


class DataFolder:
    """The shards of a recipe and a seed in a folder."""

    def __init__(self, folder: Path, recipe: Recipe, seed: int) -> None:
        self._folder, self._recipe, self._seed = folder, recipe, seed

    def pieces(self, split: Split) -> list[Piece]:
        """Returns the pieces of a split, those of each renderer together."""
        return [
            Piece(part, start, min(SHARD, part.scenes - start))
            for part in self._recipe.parts(split)
            for start in range(0, part.scenes, SHARD)
        ]

    def path(self, piece: Piece) -> Path:
        """Returns the path of a piece's shard."""
        return self._folder / f"{piece.part.name}-{piece.start // SHARD:04}.safetensors"

    def draw_missing(
        self, splits: Sequence[Split], library: Library, said: Said, over: Callable[[], bool], processes: int = 1
    ) -> bool:
        """Draws the shards that are not there, until it is over; returns whether all are there.

        Those of the first renderer come first. Each of the processes draws one shard at a time, and this one writes
        them all; their bits do not depend on the number of processes. A damaged shard that is there is found by `read`
        and `digest`. Raises JobFailure("worker-lost") if a process is killed.
        """
        order = list(self._recipe.shares)
        pieces = [piece for split in splits for piece in self.pieces(split)]
        pieces.sort(key=lambda piece: order.index(piece.part.renderer))
        total = sum(piece.count for piece in pieces)
        done = sum(piece.count for piece in pieces if self.path(piece).exists())
        missing = [piece for piece in pieces if not self.path(piece).exists()]
        with closing(each(partial(self._drawn, library=library), missing, processes, over)) as drawn:
            for piece, shard in drawn:
                write_shard(self.path(piece), shard, self._about(piece))
                done += piece.count
                said("drawing scenes", done, total, f"{done:,} of {total:,}, {piece.part.renderer}")
        return done == total

    def digest(self, split: Split) -> str:
        """Returns the digest of a split: that of its shards' digests. Raises InvalidRequest("--out") for a bad one."""
        digests = [shard_digest(self.path(piece), self._about(piece)) for piece in self.pieces(split)]
        return hashlib.sha256("".join(digests).encode()).hexdigest()

    def read(self, piece: Piece) -> Shard:
        """Reads the shard of a piece. Raises InvalidRequest("--out") if it is damaged or of other settings."""
        return read_shard(self.path(piece), self._about(piece))

    def read_all(self, split: Split) -> list[Shard]:
        """Reads all shards of a split."""
        return [self.read(piece) for piece in self.pieces(split)]

    def _about(self, piece: Piece) -> str:
        recipe, part = self._recipe, piece.part
        about = {
            "version": VERSION,
            "seed": self._seed,
            "part": part.name,
            "start": piece.start,
            "count": piece.count,
            "questions": recipe.questions,
            "varied": recipe.varied if part.split == "train" else 0.0,
        }
        return json.dumps(about)

    def _drawn(self, piece: Piece, library: Library) -> Shard:
        recipe, part = self._recipe, piece.part
        asking = QuestionGenerator(self._seed)
        scenes, questions, images = [], [], []
        for index in range(piece.start, piece.start + piece.count):
            scene = generate(self._seed, index, objects=part.objects, split=part.name)
            described = describe(scene)
            if part.split == "train":
                random = np.random.default_rng([self._seed, zlib.crc32(part.name.encode()), index])
                vary = random.random() < recipe.varied
                described = coarse(varied(described, random) if vary else described)
            images.append(draw(described, part.renderer, library))
            questions += asking.ask(scene, recipe.questions)
            scenes.append(scene)
        return shard(scenes, questions, images)


class Images:
    """The images of shards, by their number in all of them."""

    def __init__(self, of: Sequence[Shard]) -> None:
        self._places = [(shard, number) for shard in of for number in range(len(shard))]

    def __len__(self) -> int:
        return len(self._places)

    def __call__(self, chosen: Sequence[int] | NDArray[np.int64]) -> NDArray[np.uint8]:
        """Returns images, uint8 [n, 240, 320, 3]. Raises InvalidRequest("--out") for one that cannot be read."""
        try:
            return np.stack([shard.image(number) for shard, number in (self._places[k] for k in chosen)])
        except OSError as error:
            raise InvalidRequest("--out", f"an image of the data cannot be read: {error}") from error


def objects_of(of: Sequence[Shard]) -> list[tuple[ObjectTruth, ...]]:
    """Returns the objects of each scene."""
    return [tuple(ObjectTruth.of(record) for record in scene.objects) for shard in of for scene in shard.scenes]


def examples_of(of: Sequence[Shard]) -> Iterator[Example]:
    """Yields the questions as examples; their images are numbered as in `Images`."""
    starts = accumulate((len(shard) for shard in of), initial=0)
    for shard, start in zip(of, starts, strict=False):
        facts = {scene.image_index: (start + k, Facts.of(scene)) for k, scene in enumerate(shard.scenes)}
        for question in shard.questions:
            number, known = facts[question.image_index]
            yield Example.of(number, question, known)


COARSE = {"samples": 4, "texel_samples": 1}
"""Samples of shadows of `coarse`: pyrender's images differ by 0.07/255 in the mean and take two thirds of the time,
those of the torch renderer differ by 0.18/255 and take 0.6 of it."""
BRIGHTER = 0.3
"""Standard deviation of the logarithm of a varied light's energy; half as much for the light from all around."""
MOVED = 0.5
"""Standard deviation of each coordinate of a varied light's position: half of the jitter that every scene has."""
TINTED = 0.04
"""Standard deviation of each channel of a varied object's colour. CLEVR's nearest two, red and brown, are 0.23 apart
in all."""
ROUGHER = 0.1
"""Standard deviation of a varied object's roughness; half as much of its being metallic."""


def draw(scene: Scene, renderer: str, library: Library) -> Bytes:
    """Returns the exact renderer's image of a scene, uint8 [height, width, 3]."""
    return to_bytes(_image(resolve(scene, library), renderer)).numpy()


def coarse(scene: Scene) -> Scene:
    """Returns a scene with fewer samples of its shadows."""
    assert scene.shadows is not None
    return scene.model_copy(update={"shadows": scene.shadows.model_copy(update=COARSE)})


def _image(scene: ResolvedScene, renderer: str) -> Tensor:
    """Returns the exact renderer's image of a scene as it is, [height, width, 3] in [0,1]."""
    if renderer == "pyrender":  # not by `build`, which checks that an object is in view: `generate` has seen to it
        return PyrenderRenderer(scene, tolerance="exact").render({})[0]
    return build(scene, renderer, tolerance="exact").render({})[0]


def varied(scene: Scene, random: np.random.Generator) -> Scene:
    """Returns a scene with other lights, a turned environment, and slightly other colours and surfaces of its objects.

    The answers to questions stay the same.
    """

    def near(value: float, spread: float) -> float:
        return min(1.0, max(0.0, value + spread * float(random.standard_normal())))

    def brighter(value: float, spread: float) -> float:
        return value * exp(spread * float(random.standard_normal()))

    lights = scene.lights
    points = [
        point.model_copy(
            update={
                "energy": brighter(point.energy, BRIGHTER),
                "position": tuple(float(x) for x in np.add(point.position, MOVED * random.standard_normal(3))),
            }
        )
        for point in lights.points
    ]
    environment = lights.environment.model_copy(update={"rotation": float(random.uniform(-pi, pi))})
    objects = [
        solid.model_copy(
            update={
                "color": tuple(near(channel, TINTED) for channel in solid.color),
                "roughness": near(solid.roughness or 0.0, ROUGHER),
                "metallic": near(solid.metallic or 0.0, ROUGHER / 2),
            }
        )
        for solid in scene.objects
    ]
    return scene.model_copy(
        update={
            "objects": tuple(objects),
            "lights": lights.model_copy(
                update={
                    "ambient": brighter(lights.ambient, BRIGHTER / 2),
                    "points": tuple(points),
                    "environment": environment,
                }
            ),
        }
    )


def shard(scenes: Sequence[SceneRecord], questions: Sequence[QuestionRecord], images: Sequence[Bytes]) -> Shard:
    """Returns the shard of some scenes; `images` are uint8 [240, 320, 3], of the scenes in their order."""
    files = [_png(image) for image in images]
    info = Info(split=scenes[0].split)
    written = {
        "scenes": SceneFile(info=info, scenes=tuple(scenes)).model_dump_json(by_alias=True, exclude_unset=True),
        "questions": QuestionFile(info=info, questions=tuple(questions)).model_dump_json(exclude_unset=True),
    }
    png = np.frombuffer(b"".join(files), np.uint8)
    return Shard(png, np.cumsum([len(file) for file in files], dtype=np.int64), written)


def write_shard(path: Path, made: Shard, about: str) -> None:
    """Writes a shard and the text `about`, which `read` and `digest` compare."""
    arrays: dict[str, NDArray[Any]] = {"png": made.png, "ends": made.ends}
    metadata = made.written | {"about": about}
    data = safetensors.numpy.save(arrays, metadata | {"sha256": _digest(arrays, metadata)})
    disk.write(path, _in_order(data))


def shard_digest(path: Path, about: str) -> str:
    """Returns the digest that a file has of its contents. Raises InvalidRequest("--out") as `read` does."""
    return _opened(path, about, ())[1]["sha256"]


def read_shard(path: Path, about: str) -> Shard:
    """Reads a file. Raises InvalidRequest("--out") if it is damaged, or about something else."""
    arrays, metadata = _opened(path, about, ("ends", "png"))
    sha256 = metadata.pop("sha256")
    if _digest(arrays, metadata) != sha256:
        raise _damaged(path, "its contents are not those of its digest")
    return Shard(arrays["png"], arrays["ends"], {name: metadata[name] for name in ("scenes", "questions")})


def _opened(path: Path, about: str, names: Sequence[str]) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    try:
        with safe_open(path, framework="np") as file:
            metadata = dict(file.metadata() or {})
            arrays = {name: file.get_tensor(name) for name in names}
    except (SafetensorError, OSError) as error:
        raise _damaged(path, str(error)) from error
    if missing := {"scenes", "questions", "about", "sha256"} - set(metadata):
        raise _damaged(path, f"it has no {', '.join(sorted(missing))}")
    if metadata["about"] != about:
        raise InvalidRequest("--out", f"{path} has {metadata['about']}, not {about}; move it away")
    return arrays, metadata


def _in_order(file: bytes) -> bytes:
    """Returns a safetensors file with its metadata by name: the library writes them in another order each time."""
    length = int.from_bytes(file[:8], "little")
    header = json.loads(file[8 : 8 + length])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    written = json.dumps(header, separators=(",", ":")).encode()
    written += b" " * (-len(written) % 8)  # the arrays are aligned
    return len(written).to_bytes(8, "little") + written + file[8 + length :]


def _damaged(path: Path, why: str) -> InvalidRequest:
    return InvalidRequest("--out", f"{path} is damaged ({why}); delete it, and it is made anew")


def _digest(arrays: dict[str, NDArray[Any]], metadata: dict[str, str]) -> str:
    digest = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name in sorted(arrays):
        digest.update(np.ascontiguousarray(arrays[name]).data)
    return digest.hexdigest()


def _png(image: Bytes) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()
