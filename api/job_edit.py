"""What a person says about a job: a title, tags and a note."""

import re
from typing import Annotated

from pydantic import AfterValidator, ConfigDict, Field

from services.strict import Strict
from services.written_text import line, line_or_nothing, paragraphs

TAG_PATTERN = re.compile(r'[^\s,:"\x00-\x1f\x7f-\x9f]{1,50}')
TAG_WORDS = "a tag has 1 to 50 characters, without spaces, commas, colons and quotation marks"
MOST_TAGS = 20


def _tag(text: str) -> str:
    if TAG_PATTERN.fullmatch(line(text)) is None:
        raise ValueError(f"{TAG_WORDS}, not {text[:60]!r}")
    return text


Tag = Annotated[str, Field(json_schema_extra={"pattern": f"^{TAG_PATTERN.pattern}$"}), AfterValidator(_tag)]


def is_tag(text: str) -> bool:
    """Whether a job may have this tag."""
    try:
        _tag(text)
    except ValueError:
        return False
    return True


class JobEdit(Strict):
    """Changes of what people have said about a job. Fields that are left out stay as they are."""

    model_config = ConfigDict(extra="forbid")

    title: Annotated[str, Field(max_length=100), AfterValidator(line_or_nothing)] | None = Field(
        None, description='a name that a person gives the job; "" or null for none'
    )
    tags: Annotated[list[Tag], Field(max_length=MOST_TAGS)] | None = Field(
        None, description="all tags of the job, each without spaces, commas, colons and quotation marks; null for none"
    )
    note: Annotated[str, Field(max_length=10_000), AfterValidator(paragraphs)] | None = Field(
        None, description='a text; "" or null for none'
    )

    def changes(self) -> dict[str, object]:
        """The columns to write."""
        found = {name: getattr(self, name) for name in self.model_fields_set}
        return {name: (value or []) if name == "tags" else value or None for name, value in found.items()}
