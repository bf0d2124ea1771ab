"""The library's door: what is accepted as a scene, a network, labels and a folder, what is said of the rest, and what a
result gives.
"""

import base64
import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

import scene_attack as sa
from scene_attack import plugin
from scene_attack.attacks.attack import ATTACKS
from scene_attack.errors import InvalidRequest
from scene_attack.options import Options
from scene_attack.rendering.declaration import RENDERERS
from tests.unit.targets.custom.small_network import CARD, LABELS, MaiteModel, folder, save_pt2
from tests.unit.targets.custom.small_network import network as small_network

SCENE: dict[str, Any] = {"objects": [{"mesh": "primitive/sphere"}], "camera": {"size": [32, 32]}}
SPEC: dict[str, Any] = {"attack": {"renderer": "image", "steps": 1}}
SEARCH: dict[str, Any] = {"attack": {"renderer": "image", "method": "square", "steps": 2}}
SMALL = {"preprocessing": {"input_size": [8, 8]}}


def network(classes: int = 3, seed: int = 0) -> torch.nn.Module:
    """A linear network of 8×8 images."""
    layer = torch.nn.Linear(192, classes)
    weight = torch.randn(classes, 192, generator=torch.Generator().manual_seed(seed))
    with torch.no_grad():
        layer.weight.copy_(weight)
        layer.bias.zero_()
    return torch.nn.Sequential(torch.nn.Flatten(), layer)


def attack(model: Any, spec: dict[str, Any] = SPEC, out: Path | None = None, **about: Any) -> sa.Result:
    """Attacks a network of this process, of which `about` says more."""
    return sa.attack(SCENE, sa.target(model, **about), out=out, **spec)


def test_labels_of_none_are_numbers() -> None:
    result = attack(network(), labels=None, **SMALL)
    assert result.original.label in {"0", "1", "2"}


def test_labels_of_imagenet_are_its_names_and_a_library_mesh_has_its_truth() -> None:
    scene = SCENE | {"objects": [{"mesh": "furniture/grand-piano"}]}
    result = sa.attack(scene, sa.target(network(1000), labels="imagenet", **SMALL), **SPEC)
    assert result.record.verdict.truth == ["grand piano"]


@pytest.mark.parametrize("kind", [torch.Tensor, np.ndarray, list])
def test_a_function_is_attacked_by_its_scores_and_is_the_module_it_computes(kind: type) -> None:
    module = network()

    def scores(images: torch.Tensor) -> Any:
        assert not images.requires_grad
        found = module(images).detach()
        return found if kind is torch.Tensor else found.numpy() if kind is np.ndarray else found.tolist()

    found, wanted = (attack(one, SEARCH, labels=["a", "b", "c"], **SMALL) for one in (scores, module))
    assert (found.original.label, found.attacked.label) == (wanted.original.label, wanted.attacked.label)
    assert dict(found.attacked.answer.top) == pytest.approx(dict(wanted.attacked.answer.top))


def test_a_method_that_needs_gradients_of_a_function_is_refused_with_what_would_do() -> None:
    with pytest.raises(InvalidRequest, match=r"it is a function.*methods without gradients are cma-es") as refused:
        attack(lambda images: network()(images), **SMALL)
    assert refused.value.field == "attack.method"


@pytest.mark.parametrize(
    ("field", "given", "said"),
    [
        ("labels", "cat", "not 'cat'"),
        ("labels", 5, "not 5"),
        ("labels", ["cat", 7], "not 7 in a list"),
        ("preprocessing", 3, "not int"),
    ],
)
def test_a_target_of_anything_else_is_refused_by_the_name_of_its_argument(field: str, given: Any, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said) as refused:
        sa.target(network(), **{field: given})
    assert refused.value.field == field


@pytest.mark.parametrize(
    ("field", "given", "said"),
    [
        ("target", 5, "must be a torch.nn.Module, a function .*, or a target, not int"),
        ("scene", "scene.json", "must be an object such as sa.Scene, or a dictionary as a request has it, not str"),
        ("attack", [], "not list"),
        ("goal", "chair", "not str"),
    ],
)
def test_anything_else_is_refused_by_the_name_of_its_argument(field: str, given: Any, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said) as refused:
        sa.attack(**{"scene": SCENE, "target": sa.target(network(), **SMALL), **SPEC, field: given})
    assert refused.value.field == field


def test_objects_are_what_a_request_says() -> None:
    target = sa.target(network(), preprocessing=sa.Preprocessing(input_size=(8, 8)))
    scene = sa.Scene(camera=sa.Camera(size=(32, 32)), objects=[sa.Object(mesh="primitive/sphere")])
    goal = sa.Goal(least_confidence=0.0)
    whole = sa.attack(scene, target, sa.FGSM(renderer="image", steps=1), goal=goal, seed=3)
    asked = sa.attack(SCENE, target, {"renderer": "image", "method": "fgsm", "steps": 1}, seed=3)
    assert whole.record.spec == asked.record.spec
    assert whole.files["attacked.png"] == asked.files["attacked.png"]


def test_a_mesh_may_be_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh.creation.capsule().export(tmp_path / "capsule.obj")
    monkeypatch.chdir(tmp_path)
    target = sa.target(network(), **SMALL)
    shown = []
    for mesh in (Path("capsule.obj"), tmp_path / "capsule.obj", "./capsule.obj"):
        scene = sa.Scene(camera=sa.Camera(size=(32, 32)), objects=[sa.Object(mesh=mesh)])
        shown.append(sa.attack(scene, target, sa.FGSM(renderer="image", steps=1)).files["original.png"])
    assert shown[0] == shown[1] == shown[2]
    assert sa.Object(mesh=Path("../a.obj")).mesh == "./../a.obj"


def test_a_network_that_has_a_name_is_attacked_by_it() -> None:
    result = sa.attack(SCENE, "efficientnet-lite0", sa.FGSM(renderer="image", steps=1), tolerance="exact")
    assert result.record.spec["target"] == {"name": "efficientnet-lite0"}
    assert result.replay().reproduced


def test_a_result_is_saved_read_and_replayed(tmp_path: Path) -> None:
    target = sa.target(network(), **SMALL)
    result = sa.attack(SCENE, target, sa.FGSM(renderer="torch", groups=["illumination"], steps=2))
    assert (result.original.image.shape, result.original.image.dtype) == ((32, 32, 3), np.uint8)
    assert result.perturbation["illumination"].abs().max() > 0
    assert result.original.label == result.record.original.label
    result.save(tmp_path / "out")
    again = sa.load(tmp_path / "out")
    assert again.files == result.files
    assert again.replay(target).reproduced
    assert result._repr_html_().count("data:image/png;base64,") == 3
    with pytest.raises(InvalidRequest, match="holds the result of another job"):
        sa.attack(SCENE, target, sa.FGSM(renderer="image", steps=1)).save(tmp_path / "out")
    with pytest.raises(InvalidRequest, match="is not the output of a finished job"):
        sa.load(tmp_path)


def test_a_replay_of_another_network_is_refused() -> None:
    result = attack(network(), **SMALL)
    with pytest.raises(InvalidRequest, match="weights"):
        result.replay(sa.target(network(seed=1), **SMALL))
    with pytest.raises(InvalidRequest, match="there is no target 'module'"):
        result.replay()


def test_the_truth_is_what_an_attack_takes_for_it() -> None:
    piano, ball = ({"mesh": f"furniture/{name}"} for name in ("grand-piano", "soccer-ball"))
    imagenet = sa.target(network(1000), labels="imagenet", **SMALL)
    assert sa.truth({"objects": [piano]}, imagenet) == ("grand piano",)
    assert sa.truth(sa.Scene(objects=[sa.Object(**piano)]), "efficientnet-lite0") == ("grand piano",)
    assert sa.truth({"objects": [piano, ball]}, imagenet) == ()
    assert sa.truth({"objects": [piano]}, sa.target(network(), **SMALL)) == ()
    kinds = ("chair sofa table cabinet lamp door plant tree cup", "hand tool", "animal car cycle socket")
    labels = [*kinds[0].split(), kinds[1], *kinds[2].split()]  # those of the furniture networks, known by their words
    couch = {"objects": [{"mesh": "furniture/couch"}]}
    assert sa.truth(couch, sa.target(network(14), labels=labels, **SMALL)) == ("sofa",)
    assert sa.truth(couch, sa.target(network(14), labels=labels[::-1], **SMALL)) == ()
    with pytest.raises(InvalidRequest, match="there is no target 'nobody'"):
        sa.truth({"objects": [piano]}, "nobody")


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (
            torch.nn.Sequential(network(), torch.nn.Dropout()).train().forward,
            "dropout or batch normalisation in training",
        ),
        (network().to("meta"), "meta"),
        (network().to("meta").forward, "meta"),
    ],
    ids=["training", "module elsewhere", "function elsewhere"],
)
def test_a_network_in_training_or_elsewhere_is_refused_in_a_sentence(model: Any, said: str) -> None:
    torch.manual_seed(0)  # by chance dropout may leave both images of a trial the same scores
    with pytest.raises(InvalidRequest, match=said):
        attack(model, SEARCH, labels=["a", "b", "c"], **SMALL)


def test_a_module_in_training_is_attacked_as_it_is_in_use() -> None:
    module = torch.nn.Sequential(network(), torch.nn.Dropout()).train()
    assert attack(module, SEARCH, **SMALL).attacked.answer == attack(network(), SEARCH, **SMALL).attacked.answer
    assert module.training


def test_a_renderer_is_for_a_loop_of_ones_own() -> None:
    renderer = sa.renderer(SCENE, "torch", groups=["illumination"])
    light = renderer.initial()["illumination"][None].clone().requires_grad_()
    renderer.render({"illumination": light}).sum().backward()  # type: ignore[no-untyped-call]
    assert light.grad is not None
    assert bool(light.grad.abs().sum() > 0)


def test_a_renderer_is_attacked_in_its_scenes_place() -> None:
    target = sa.target(network(), **SMALL)
    renderer = sa.renderer(sa.Scene(**SCENE), "torch", groups=["illumination"], tolerance=0.01)
    found = sa.attack(renderer, target, sa.FGSM(steps=2))
    attack = {"renderer": "torch", "groups": ["illumination"], "steps": 2}
    wanted = sa.attack(SCENE, target, attack, tolerance=0.01)
    assert found.record.spec == wanted.record.spec
    assert found.files["attacked.png"] == wanted.files["attacked.png"]
    other = sa.attack(renderer.exact(), target, sa.FGSM(renderer="image", steps=1))
    assert other.record.spec["tolerance"] == "exact"
    asked: Any = other.record.spec["attack"]
    assert (asked["renderer"], asked["groups"]) == ("image", ["image"])


def test_an_attack_and_a_renderer_of_a_script_work_in_its_process() -> None:
    class Lighter(sa.Attack):
        """All values rise."""

        method: Literal["lighter"] = "lighter"
        needs_gradient: ClassVar[bool] = False

        def init(self, problem: Any) -> Any:
            return {"delta": problem.start}

        def step(self, problem: Any, state: Any, _: Any) -> Any:
            return {"delta": problem.limits.clamp(state["delta"] + 0.25)}

    class Grey(plugin.DeclaredRenderer):
        """An image of one grey."""

        def __init__(self, size: tuple[int, int]) -> None:
            self.size, self.backend = size, "grey"
            self.plan = plugin.Plan.of(self.name, self.groups, size, "exact", [])

        @classmethod
        def build(cls, request: plugin.BuildRequest) -> Any:
            return cls(request.scene.description.camera.size)

        def initial(self) -> Any:
            return {"grey": torch.zeros(1)}

        def bounds(self) -> Any:
            return {"grey": (torch.tensor(0.0), torch.tensor(1.0))}

        def render(self, parameters: Any) -> torch.Tensor:
            shown: torch.Tensor = parameters["grey"][:, None, None, :].expand(-1, *self.size, 3)
            return shown

        def exact(self) -> Any:
            return self

    grey = plugin.Group(name="grey", shape=("1",), unit="displayed value", words="grey", suggested_step=0.1)
    attacks, renderers = ATTACKS.snapshot(), RENDERERS.snapshot()
    try:
        plugin.register_attack(Lighter)
        declared = plugin.Declaration(name="grey", groups=(grey,), differentiable=True, method="lighter")
        plugin.register_renderer(declared)(Grey)
        target = sa.target(lambda images: images.mean((2, 3))[:, :2] * torch.tensor([0, 1]) + torch.tensor([0.2, 0]))
        result = sa.attack(sa.renderer(SCENE, "grey"), target, Lighter(steps=5, truncation=None))
    finally:
        ATTACKS.restore(attacks)
        RENDERERS.restore(renderers)
    assert result.record.spec["attack"]["method"] == "lighter"
    assert float(result.perturbation["grey"]) == pytest.approx(0.25)


def test_options_of_another_process_are_refused() -> None:
    with pytest.raises(InvalidRequest, match=r"this process has .* already and cannot change to torch"):
        sa.attack(SCENE, sa.target(network(), **SMALL), **SPEC, options=Options(kernels="torch"))


def test_every_public_name_is_there() -> None:
    assert all(getattr(sa, name) is not None for name in sa.__all__)
    assert dir(sa) == sorted(sa.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = sa.nothing


def test_a_folder_with_another_result_is_refused_and_the_same_request_is_taken(tmp_path: Path) -> None:
    attack(network(), out=tmp_path / "out", **SMALL)
    attack(network(), out=tmp_path / "out", **SMALL)
    before = (tmp_path / "out" / "result.json").read_bytes()
    others: list[tuple[Any, dict[str, Any], dict[str, Any]]] = [
        (network(seed=1), SPEC, SMALL),
        (network(), SPEC | {"seed": 1}, SMALL),
        (network(), SPEC, SMALL | {"labels": list("xyz")}),
        (network(), SPEC, {"preprocessing": {"input_size": [8, 8], "mean": [0.1, 0.2, 0.3]}}),
        (network().forward, SEARCH, SMALL),
    ]
    for model, spec, about in others:
        with pytest.raises(InvalidRequest, match=r"holds the result of another (job|network)") as refused:
            attack(model, spec, tmp_path / "out", **about)
        assert refused.value.field == "out"
    attack(network().forward, SEARCH, tmp_path / "function", **SMALL)
    with pytest.raises(InvalidRequest, match="holds the result of another network"):  # it may be another function
        attack(network().forward, SEARCH, tmp_path / "function", **SMALL)
    with pytest.raises(InvalidRequest, match="is a file; name a folder"):
        attack(network(), out=tmp_path / "out" / "result.json", **SMALL)
    assert (tmp_path / "out" / "result.json").read_bytes() == before


def test_a_type_checker_takes_what_a_program_writes(tmp_path: Path) -> None:
    program = """
from pathlib import Path

import scene_attack as sa

thing: sa.Object = sa.Object(mesh=Path("chair.obj"), material="plastic")
scene = sa.Scene(camera=sa.Camera(size=(64, 64)), objects=[thing], lights=sa.Lights(points=[sa.PointLight()]))
first: sa.Object = scene.objects[0]
name: str = first.mesh
attack = sa.FGSM(renderer="torch", groups=["illumination"])
result = sa.attack(sa.renderer(scene), "efficientnet-lite0", attack, goal=sa.Goal(truth="chair"))
columns = [{"name": "light", "attack": attack}]
grid = sa.Grid(scenes=[scene], targets=["efficientnet-lite0"], attacks=columns, selection={"right": False})
campaign = sa.Campaign(name="cubes", grids=[grid])
sa.Object(mesh=5)
"""
    (tmp_path / "program.py").write_text(program)
    (tmp_path / "none.ini").write_text("[mypy]\n")
    options = ["--strict", "--follow-imports=silent", "--config-file=none.ini", "program.py"]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *options], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    first, *others = done.stdout.splitlines()
    assert first.startswith('program.py:15: error: Argument "mesh" to "SceneObject" has incompatible type "int"')
    assert others == ["Found 1 error in 1 file (checked 1 source file)"]


@pytest.fixture
def answering() -> Iterator[str]:
    """The URL of a server that answers with the means of red, green and blue."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            images = json.loads(self.rfile.read(int(self.headers["Content-Length"])))["images"]
            means = [np.asarray(Image.open(BytesIO(base64.b64decode(one)))).mean((0, 1)).tolist() for one in images]
            body = json.dumps({"scores": means}).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/classify"
        server.shutdown()
        thread.join()


def test_a_url_is_a_target_by_its_scores(answering: str) -> None:
    result = attack(answering, SEARCH, labels=["red", "green", "blue"], **SMALL)
    assert result.record.spec["target"]["name"] == "module"
    means = result.original.image.mean((0, 1))
    assert result.original.label == ["red", "green", "blue"][int(means.argmax())]


def test_a_folder_is_the_network_that_is_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_pt2(folder(tmp_path, "mine") / "model.pt2")
    monkeypatch.chdir(tmp_path)
    about = {"labels": LABELS, "preprocessing": CARD["preprocessing"]}
    wanted = attack(small_network(), SEARCH, **about)
    for given in ("./mine", Path("mine"), tmp_path / "mine"):
        found = sa.attack(SCENE, given, **SEARCH)
        assert found.record.spec["target"]["name"] == "mine"
        assert dict(found.original.answer.top) == pytest.approx(dict(wanted.original.answer.top), abs=1e-6)
        assert found.replay(sa.target(given)).reproduced


def test_a_maite_model_is_a_target_with_its_own_labels() -> None:
    about = {"preprocessing": CARD["preprocessing"]}
    found = attack(MaiteModel(), output="probabilities", **about)
    wanted = attack(small_network(), labels=LABELS, **about)
    assert dict(found.attacked.answer.top) == pytest.approx(dict(wanted.attacked.answer.top), abs=1e-6)


def test_a_listed_target_is_got_by_its_name() -> None:
    made = sa.target("efficientnet-lite0")
    assert len(made.labels) == 1000
    assert sa.attack(SCENE, made, **SPEC).record.spec["target"]["name"] == "efficientnet-lite0"


@pytest.mark.parametrize(
    ("given", "about", "field", "said"),
    [
        ("./nowhere", {}, "target", "there is no folder './nowhere'"),
        (Path(), {}, "target", r"is no target: card.json: there is no such file"),
        ("nobody", {}, "target.name", "there is no target 'nobody'"),
        ("efficientnet-lite0", {"labels": ["a"]}, "labels", "leave this out"),
        ("efficientnet-lite0", {"name": "mine"}, "name", "leave this out"),
        ("http://127.0.0.1:1/", {}, "labels", "a URL does not say its labels"),
        ("http://example.org/", {"labels": ["a"]}, "target", "neither https nor on this machine"),
        (MaiteModel(), {"labels": ["a"]}, "labels", "metadata.index2label has 5 labels"),
        (MaiteModel(), {"output": "logits"}, "output", "not 'logits'"),
    ],
)
def test_what_cannot_be_a_target_is_refused(
    given: Any, about: dict[str, Any], field: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidRequest, match=said) as refused:
        sa.target(given, **about)
    assert refused.value.field == field
