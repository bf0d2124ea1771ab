"""The features that the finished trunk has of all images, which the engine is trained on."""

import hashlib
import io
from collections.abc import Callable
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from services import disk
from services.errors import InvalidRequest
from services.rendering.color import from_bytes
from services.targets.iep.engine import Trunk
from training.iep.data import DataFolder, Images, Said, Shard
from training.iep.recipe import Split

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


def write_missing(
    folder: Path, trunk: Trunk, data: DataFolder, split: Split, said: Said, over: Callable[[], bool]
) -> bool:
    """Writes the features of a split's shards that are not there, until it is over; returns whether all are there."""
    pieces, about = data.pieces(split), digest_of(trunk)
    for number, piece in enumerate(pieces):
        path = folder / data.path(piece).name
        if path.exists() and _about(path) == about:
            continue
        if over():
            return False
        disk.write(path, save({"features": features_of(trunk, data.read(piece))}, {"trunk": about}))
        said("computing features", number + 1, len(pieces), "")
    return True


def read_all(folder: Path, data: DataFolder, split: Split) -> Tensor:
    """Returns the features of all images of a split, float16 [V, 96, 15, 20]."""
    shards = []
    for piece in data.pieces(split):
        with safe_open(folder / data.path(piece).name, framework="pt") as file:
            shards.append(file.get_tensor("features"))
    return torch.cat(shards)


def _about(path: Path) -> str:
    try:
        with safe_open(path, framework="pt") as file:
            return str((file.metadata() or {}).get("trunk"))
    except (SafetensorError, OSError) as error:
        raise InvalidRequest("--out", f"{path} is damaged ({error}); delete it, and it is made anew") from error
