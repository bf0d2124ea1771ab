"""A scene as another program describes it, `scene.source`: the fields of the scene follow from it.

A format is a model that is registered under its name (`register_source`): "file" is ours, and plug-ins add others.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeVar

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from scene_attack.plugins import Registry
from scene_attack.strict import Model, schema_of
from scene_attack.text import there_are


class Source(Model):
    """Base class of a format: a scene as another program describes it, or what to make it of.

    A format has the field `format`, of which its name is the only value.
    """

    slow: ClassVar[str | None] = None
    """The field from which a scene takes milliseconds to make, so that the jobs of a campaign may have few of them."""

    @abstractmethod
    def filled_in(self) -> Self:
        """Returns the description that a stored request states, such as the scene that was to be made."""

    @abstractmethod
    def follows(self) -> dict[str, Any]:
        """Returns the fields of the `Scene` that follow. Raises InvalidRequest, which names a field of the source."""

    def left_out(self) -> Sequence[str]:
        """Returns what of the source is not in the scene, a phrase each; a job has a warning of each."""
        return ()

    @abstractmethod
    def check(self, scene: Any) -> None:
        """Checks the `Scene` that a request gives beside its source.

        Raises InvalidRequest, which names a field of the request: "scene.camera.size".
        """


SOURCES: Registry[type[Source]] = Registry("format of scenes", ["scene_attack.scenes.file_source"])

AnySourceType = TypeVar("AnySourceType", bound=type[Source])


def register_source(name: str) -> Callable[[AnySourceType], AnySourceType]:
    """Returns a decorator of a format. Raises ValueError for a name that is taken."""

    def decorate(source: AnySourceType) -> AnySourceType:
        SOURCES.add(name, source)
        return source

    return decorate


class _Registered:
    """Validates a source by the model of its format. Formats may be registered after this module was imported."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        def validate(data: object, info: ValidationInfo) -> Source:
            if isinstance(data, Source):
                return data
            if not isinstance(data, Mapping):
                raise ValueError("must be an object with a `format`")
            name = data.get("format")
            if not isinstance(name, str) or name not in SOURCES:
                raise ValueError(f"format: there is no {name!r}; {there_are(str(name), SOURCES)}")
            return SOURCES[name].model_validate(data, context=info.context)  # its errors become those of the field

        return core_schema.with_info_plain_validator_function(validate)

    @classmethod
    def __get_pydantic_json_schema__(cls, _schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return schema_of(list(SOURCES.values()), handler)


if TYPE_CHECKING:
    AnySource = Source
else:
    AnySource = Annotated[Any, _Registered]
