"""Settings of a renderer's own, and packages that it needs: checked with the request, and handed to the renderer."""

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import pytest
import torch
from pydantic import Field
from torch import Tensor

from scene_attack.cli.specs import local_library
from scene_attack.errors import InvalidRequest
from scene_attack.extras import MissingExtra
from scene_attack.options import DEFAULTS
from scene_attack.rendering.declaration import RENDERERS, BuildRequest, Declaration, DeclaredRenderer, Group, register
from scene_attack.rendering.factory import build
from scene_attack.rendering.plan import Plan
from scene_attack.runs import field_errors
from scene_attack.runs.prepare import prepare
from scene_attack.runs.spec import JobSpec, parse
from scene_attack.scenes.resolve import resolve
from scene_attack.strict import Model

SCENE = {"camera": {"size": [2, 2]}, "objects": [{"mesh": "primitive/sphere"}]}


class Haze(Model):
    """Settings of the haze."""

    grains: int = Field(default=16, ge=1, description="grains of a pixel")
    seed: int = 0


def needs_a_lens(field: str) -> None:
    raise MissingExtra(field, "the renderer haze needs a lens")


class HazeRenderer(DeclaredRenderer):
    """A grey sheet, which keeps the settings that it was built with."""

    size: ClassVar[tuple[int, int]] = (2, 2)
    backend = "haze"
    plan = property(lambda self: Plan.of(self.name, self.groups, self.size, "exact", []))

    def __init__(self, settings: Haze) -> None:
        self.settings = settings

    @classmethod
    def build(cls, request: BuildRequest) -> "HazeRenderer":
        return cls(request.settings)

    def initial(self) -> dict[str, Tensor]:
        return {"level": torch.tensor([0.5])}

    def bounds(self) -> Mapping[str, tuple[Tensor, Tensor]]:
        return {"level": (torch.zeros(1), torch.ones(1))}

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        return parameters["level"][:, None, None].expand(-1, *self.size, 3)

    def exact(self) -> "HazeRenderer":
        return self


def declare(**fields: Any) -> None:
    level = Group(name="level", shape=("1",), unit="1", words="level", suggested_step=0.01)
    declared = {"name": "haze", "groups": (level,), "differentiable": True, "method": "fgsm"}
    register(Declaration(**declared | {"settings": Haze} | fields))(HazeRenderer)


@pytest.fixture(autouse=True)
def registry() -> Iterator[None]:
    before = RENDERERS.snapshot()
    RENDERERS.restore({name: declared for name, declared in before.items() if declared.settings is None})
    field_errors._schema.cache_clear()  # noqa: SLF001 - of the renderers that there were
    yield
    RENDERERS.restore(before)
    field_errors._schema.cache_clear()  # noqa: SLF001


def spec(attack: Mapping[str, Any], **fields: Any) -> JobSpec:
    return parse({"scene": SCENE, "attack": attack, **fields})


def test_settings_that_are_left_out_are_filled_in_and_written() -> None:
    declare()
    stated = spec({"renderer": "haze", "renderer_settings": {"seed": 7}})
    assert stated.model_dump(mode="json")["attack"]["renderer_settings"] == {"grains": 16, "seed": 7}
    none = spec({"renderer": "haze"})
    assert none.model_dump(mode="json")["attack"]["renderer_settings"] == {"grains": 16, "seed": 0}
    assert parse(stated.model_dump(mode="json")) == stated
    assert "renderer_settings" not in spec({"renderer": "torch"}).model_dump(mode="json")["attack"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"grains": 0},
            "attack.renderer_settings.grains: must be an integer of at least 1, not 0: grains of a pixel",
        ),
        ({"grain": 1}, "attack.renderer_settings.grain: there is no such field; "),
        (7, "attack.renderer_settings: "),
    ],
)
def test_a_wrong_setting_is_named(settings: object, message: str) -> None:
    declare()
    with pytest.raises(InvalidRequest) as refused:
        spec({"renderer": "haze", "renderer_settings": settings})
    assert str(refused.value).startswith(message), refused.value


def test_a_renderer_without_settings_refuses_them() -> None:
    words = "attack.renderer_settings: renderer torch has no settings of its own; leave this out"
    with pytest.raises(InvalidRequest, match=f"^{words}$"):
        spec({"renderer": "torch", "renderer_settings": {}})


def test_a_renderer_is_built_with_its_settings() -> None:
    declare()
    scene = resolve(spec({}).scene, local_library(DEFAULTS))
    assert build(scene, "haze", settings=Haze(grains=3)).settings == Haze(grains=3)  # type: ignore[attr-defined]
    assert build(scene, "haze").settings == Haze()  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("request_", "field"),
    [
        ({"attack": {"renderer": "haze"}}, "attack.renderer"),
        ({"attack": {"renderer": "image", "base_renderer": "haze"}}, "attack.base_renderer"),
        (
            {"attack": {"renderer": "pyrender"}, "analysis": {"second_opinion": {"renderers": ["haze"]}}},
            "analysis.second_opinion.renderers.0",
        ),
    ],
)
def test_a_missing_package_is_named_before_anything_is_rendered(request_: dict[str, Any], field: str) -> None:
    declare(requires=needs_a_lens)
    with pytest.raises(InvalidRequest, match=f"^{field}: the renderer haze needs a lens$"):
        prepare(spec(**request_), local_library(DEFAULTS))
