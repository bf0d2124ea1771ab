"""Programs from outside: what torch's own loader would run is refused, and what is kept is what torch computes."""

import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from scene_attack.errors import Unreadable
from scene_attack.targets.custom import exported
from tests.unit.targets.custom.small_network import SIZE, save_pt2

pytestmark = pytest.mark.slow

Document = dict[str, Any]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("program") / "model.pt2"
    save_pt2(path)
    return path


def rewritten(
    source: Path,
    target: Path,
    change: Callable[[Document], None] = lambda _: None,
    *,
    member: str = "models/model.json",
    add: dict[str, bytes] | None = None,
    compressed: bool = False,
) -> Path:
    """The archive with one JSON member changed, and members added or replaced."""
    kind = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w", kind) as new:
        root = old.namelist()[0].partition("/")[0]
        members = {name.partition("/")[2]: old.read(name) for name in old.namelist()} | (add or {})
        document = json.loads(members[member])
        change(document)
        members[member] = json.dumps(document).encode()
        for name, data in members.items():
            new.writestr(f"{root}/{name}", data)
    return target


class Harm:
    """An object whose unpickling makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.path,))


def test_nothing_in_it_is_unpickled(program: Path, tmp_path: Path) -> None:
    """The example inputs, which every program has, are a pickle that torch's loader reads without restrictions."""
    made = tmp_path / "made"
    harm = pickle.dumps(Harm(made))
    path = rewritten(program, tmp_path / "harm.pt2", add={"data/sample_inputs/model.pt": harm})
    network = exported.read(path, SIZE)
    assert network(torch.zeros(1, 3, *SIZE)).shape == (1, 5)
    assert not made.exists()
    pickle.loads(harm)
    assert made.exists()  # so it would have been seen


def pickled_weight(document: Document) -> None:
    next(iter(document["config"].values()))["use_pickle"] = True


def object_constant(document: Document) -> None:
    document["config"]["thing"] = {"path_name": "opaque_obj_0", "is_param": False, "use_pickle": True}


def short_weight(document: Document) -> None:
    next(iter(document["config"].values()))["tensor_meta"]["sizes"][0] = {"as_int": 10**6}


def elsewhere(document: Document) -> None:
    next(iter(document["config"].values()))["path_name"] = "../../../etc/passwd"


def calls(target: str) -> Callable[[Document], None]:
    def change(document: Document) -> None:
        document["graph_module"]["graph"]["nodes"][0]["target"] = target

    return change


def newer(document: Document) -> None:
    document["schema_version"]["major"] = 9


def nameless(document: Document) -> None:
    document["graph_module"]["graph"]["nodes"][3]["inputs"][0]["arg"] = {"as_tensor": {"name": "nothing"}}


def text_argument(document: Document) -> None:
    document["graph_module"]["graph"]["nodes"][0]["inputs"][0]["arg"] = {"as_custom_obj": {"name": "x"}}


WEIGHTS, CONSTANTS = "data/weights/model_weights_config.json", "data/constants/model_constants_config.json"
REFUSED: dict[str, tuple[Document, str]] = {
    "a pickled weight": ({"change": pickled_weight, "member": WEIGHTS}, "stored as a pickle"),
    "a pickled object": ({"change": object_constant, "member": CONSTANTS}, "'thing' is stored as a pickle"),
    "a weight longer than its bytes": ({"change": short_weight, "member": WEIGHTS}, "does not fit its"),
    "a weight elsewhere": ({"change": elsewhere, "member": WEIGHTS}, "is stored as a pickle"),
    "a function of torch": ({"change": calls("torch.os.system")}, "the operator 'torch.os.system', which is not"),
    "a function of torch's operators": ({"change": calls("torch.ops.load_library")}, "'torch.ops.load_library'"),
    "a reader of files": ({"change": calls("torch.ops.aten.from_file.default")}, "aten.from_file.default"),
    "an attribute of an operator": ({"change": calls("torch.ops.aten.relu.__class__")}, "aten.relu.__class__"),
    "a shape's method": ({"change": calls("_operator.methodcaller")}, "_operator.methodcaller"),
    "another schema": ({"change": newer}, "its schema has the version 9, not 8"),
    "a value from nowhere": ({"change": nameless}, "needs 'nothing', which nothing before it makes"),
    "an object as an argument": ({"change": text_argument}, "an argument of the kind 'as_custom_obj'"),
    "compiled code": ({"add": {"data/aotinductor/model/m.so": b""}}, "compiled machine code, which is never loaded"),
    "compressed members": ({"compressed": True}, "its members are compressed"),
    "another format": ({"add": {"archive_format": b"ts"}}, "it was not written by torch.export.save"),
}


@pytest.mark.parametrize("harm", REFUSED)
def test_what_could_run_code_or_is_damaged_is_refused(program: Path, tmp_path: Path, harm: str) -> None:
    options, said = REFUSED[harm]
    path = rewritten(program, tmp_path / "harm.pt2", **options)
    with pytest.raises(Unreadable, match=said):
        exported.read(path, SIZE)


def test_a_file_that_is_no_archive(tmp_path: Path) -> None:
    path = tmp_path / "model.pt2"
    path.write_bytes(b"no archive")
    with pytest.raises(Unreadable, match=r"it is no archive of torch.export.save"):
        exported.read(path, SIZE)
    torch.save(nn.Flatten().state_dict(), path)
    with pytest.raises(Unreadable, match=r"neither TorchScript nor what torch.save wrote is read"):
        exported.read(path, SIZE)


class Attention(nn.Module):
    """Parts of a vision transformer: patches, a class token, attention, layer normalisation, GELU, lengths."""

    def __init__(self) -> None:
        super().__init__()
        self.patches = nn.Conv2d(3, 16, 8, stride=8)
        self.token = nn.Parameter(torch.randn(1, 1, 16))
        self.register_buffer("place", torch.randn(1, 17, 16), persistent=False)
        self.norm = nn.LayerNorm(16)
        self.attention = nn.MultiheadAttention(16, 4, batch_first=True)
        self.mix = nn.Sequential(nn.Linear(16, 32), nn.GELU(), nn.Dropout(0.1), nn.Linear(32, 16))
        self.head = nn.Linear(16, 5)

    def forward(self, x: Tensor) -> Tensor:
        x = self.patches(x).flatten(2).transpose(1, 2)
        x = torch.cat([self.token.expand(x.shape[0], -1, -1), x], dim=1) + self.place
        y = self.norm(x)
        x = x + self.attention(y, y, y, need_weights=False)[0]
        left, right = self.mix(x).chunk(2, dim=-1)
        found: Tensor = self.head(torch.cat([left, right.clamp(max=float("inf"))], dim=-1)[:, 0])
        return found


class InPlace(nn.Module):
    """Activations that overwrite their input, a view by the number of images, and a constant."""

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu_(x * torch.tensor([1.0, -1.0, 0.5])[:, None, None])
        return y.view(x.shape[0], -1).unfold(1, 64, 64).mean(dim=1)[:, :7]


@pytest.mark.parametrize("fixed", [None, 1, 3])
@pytest.mark.parametrize("make", [Attention, InPlace])
def test_it_computes_what_torch_does(make: Callable[[], nn.Module], fixed: int | None, tmp_path: Path) -> None:
    torch.manual_seed(1)
    module = make().eval()
    save_pt2(tmp_path / "model.pt2", module, fixed)
    network = exported.read(tmp_path / "model.pt2", SIZE)
    x = torch.rand(4, 3, *SIZE).requires_grad_()
    (wanted, found) = (module(x), network(x))
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-6)
    slopes = [torch.autograd.grad(scores[:, 1].sum(), x)[0] for scores in (wanted, found)]
    torch.testing.assert_close(slopes[1], slopes[0], rtol=1e-4, atol=1e-7)


class Learning(nn.Module):
    """It counts how often it is asked, in a weight."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("count", torch.zeros(()))

    def forward(self, x: Tensor) -> Tensor:
        self.count.add_(1)
        return x.mean(dim=(2, 3)) * self.count


def test_a_program_that_changes_its_weights_is_refused(tmp_path: Path) -> None:
    save_pt2(tmp_path / "model.pt2", Learning())
    with pytest.raises(Unreadable, match=r"changes its weight|it returns 2 values"):
        exported.read(tmp_path / "model.pt2", SIZE)
