"""Parses the JSON body of a request into a model in a thread, so that a large or costly one delays no other request."""

from collections.abc import Callable
from typing import Annotated, Any, TypeVar

from fastapi import Body
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from api.authentication import CallerDependency
from api.problems import BadRequestField
from api.state import ServicesDependency, names_of
from services.errors import InvalidRequest
from services.json_text import NESTED
from services.names import Names
from services.strict import is_nested_deeper

Parsed = TypeVar("Parsed", bound=BaseModel)


class _Unparsed:
    """Marks JSON that is taken as it is, and described in the OpenAPI document as the model it will be parsed into."""

    def __init__(self, model: type[BaseModel]) -> None:
        self.model = model

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Anything is valid."""
        return core_schema.any_schema()

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """A reference to the schema of the model."""
        # Pydantic refers to a model that is part of another schema, and would write out one that stands alone.
        return handler(core_schema.definitions_schema(self.model.__pydantic_core_schema__, []))


def body_of(model: type[Parsed]) -> Callable[..., Parsed]:
    """Returns a dependency that parses the body. It answers 422 as if the framework had parsed the body.

    Of a body that is invalid, the names in it that there are not are invalid, too.
    """

    def parsed(
        data: Annotated[Any, Body(), _Unparsed(model)], services: ServicesDependency, caller: CallerDependency
    ) -> Parsed:
        if is_nested_deeper(data):
            raise BadRequestField(InvalidRequest("body", NESTED))
        try:
            return model.model_validate(data)
        except ValidationError as error:
            items = _with_names(data, model, error, names_of(services, caller)).errors(include_url=False)
            raise RequestValidationError([item | {"loc": ("body", *item["loc"])} for item in items]) from error

    return parsed


def _with_names(data: Any, model: type[BaseModel], error: ValidationError, names: Names) -> ValidationError:
    try:
        model.model_validate(data, context=names)
    except ValidationError as whole:
        return whole
    return error
