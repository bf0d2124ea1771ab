"""The adversaries of a campaign as a dataset: a folder, and a class that reads it by MAITE's protocol.

The folder holds `images/<id>.png` and `originals/<id>.png` (8 bits, RGB), `labels.json` (the labels, in the order of
their indices) and `metadata.json` (the dataset's id and a list of the images' metadata).
"""

import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import numpy.typing as npt
from PIL import Image

from scene_attack import disk
from scene_attack.errors import InvalidRequest
from scene_attack.runs.result import ATTACKED, ORIGINAL, Result, success
from scene_attack.runs.spec import attack_name, scene_name

FORMAT = 1


class AdversaryMetadata(TypedDict):
    """Metadata of an image. `truth` are all labels that are right; `answer` is the attacked network's. The azimuth
    is the camera's, radians.
    """

    id: str
    target: str
    scene: str
    azimuth: float
    attack: str
    seed: int
    truth: list[str]
    answer: str
    confidence: float
    original_confidence: float
    perceptibility: float
    queries: int
    credits: list[str]


class DatasetMetadata(TypedDict):
    """The id of the dataset, and its labels by index."""

    id: str
    index2label: dict[int, str]


class AdversaryDataset:
    """Verified adversaries as images with their true labels; satisfies `maite.protocols.image_classification.Dataset`.

    `dataset[i]` is (image, label, metadata): the image is float32 [3, H, W] in [0,1], RGB; the label is float32
    [classes], 1 at the indices of the labels that are right, divided by their number. `original(i)` is the image before
    the attack. Iterating and `len` work as for any sequence. MAITE itself is not needed.
    """

    def __init__(self, folder: Path | str) -> None:
        """Raises InvalidRequest("folder") if the folder is not a dataset that `export` wrote."""
        self._folder = Path(folder)
        try:
            about = json.loads((self._folder / "metadata.json").read_text("utf-8"))
            labels: list[str] = json.loads((self._folder / "labels.json").read_text("utf-8"))
            self._items: list[AdversaryMetadata] = about["images"]
            self.metadata = DatasetMetadata(id=about["id"], index2label=dict(enumerate(labels)))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InvalidRequest("folder", f"{folder} is no dataset of adversaries: {error}") from error
        self._index = {label: index for index, label in enumerate(labels)}

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, index: int, /) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], AdversaryMetadata]:
        item = self._items[index]
        label = np.zeros(len(self._index), np.float32)
        label[[self._index[name] for name in item["truth"]]] = 1 / len(item["truth"])
        return self._image("images", item), label, item

    def original(self, index: int) -> npt.NDArray[np.float32]:
        """The image before the attack, float32 [3, H, W] in [0,1]."""
        return self._image("originals", self._items[index])

    def _image(self, kind: str, item: AdversaryMetadata) -> npt.NDArray[np.float32]:
        with Image.open(self._folder / kind / f"{item['id']}.png") as image:
            return np.asarray(image.convert("RGB"), np.float32).transpose(2, 0, 1) / np.float32(255)


def export(results: Iterable[tuple[Result, Path]], folder: Path, name: str) -> int:
    """Writes the verified adversaries among the results, with their images, as a dataset; returns their number.

    With each result comes the folder of its original.png and attacked.png. Raises InvalidRequest("maite") if the folder
    is there and is not empty.
    """
    if folder.exists() and any(folder.iterdir()):
        raise InvalidRequest("maite", f"{folder} is not empty; name a new folder")
    items: list[AdversaryMetadata] = []
    labels: dict[str, None] = {}
    for result, files in results:
        if not success(result):
            continue
        item = _metadata(result, f"{len(items):05}")
        labels |= dict.fromkeys(_labels(result))
        for kind, file in (("images", ATTACKED), ("originals", ORIGINAL)):
            (folder / kind).mkdir(parents=True, exist_ok=True)
            shutil.copyfile(files / file, folder / kind / f"{item['id']}.png")
        items.append(item)
    about: dict[str, Any] = {"format": FORMAT, "id": f"scene-attack adversaries: {name}", "images": items}
    disk.write(folder / "labels.json", json.dumps(list(labels), ensure_ascii=False, indent=1).encode())
    disk.write(folder / "metadata.json", json.dumps(about, ensure_ascii=False, indent=1).encode())
    return len(items)


def _labels(result: Result) -> tuple[str, ...]:
    """The labels of the result's target if it is installed, else those that the result names."""
    from scene_attack.targets.info import TARGETS

    name = str(dict(result.spec["target"])["name"])  # type: ignore[call-overload]
    if name in TARGETS:
        return TARGETS[name].labels()
    return tuple(dict.fromkeys((*result.verdict.truth, result.attacked.label)))


def _metadata(result: Result, number: str) -> AdversaryMetadata:
    spec: dict[str, Any] = dict(result.spec)
    return AdversaryMetadata(
        id=number,
        target=spec["target"]["name"],
        scene=scene_name(spec),
        azimuth=spec["scene"]["camera"]["azimuth"],
        attack=attack_name(spec),
        seed=result.provenance.seed,
        truth=result.verdict.truth,
        answer=result.attacked.label,
        confidence=result.attacked.confidence,
        original_confidence=result.original.confidence,
        perceptibility=result.change.perceptibility,
        queries=result.cost.queries,
        credits=result.provenance.credits,
    )
