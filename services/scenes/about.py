"""What people say of a file that they upload: its name, which way is up, and whose it is."""

import json
from pathlib import PurePath
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from services.written_text import line, visible

LONGEST_TITLE = 100
Up = Literal["y", "z"]
Title = Annotated[
    str,
    Field(min_length=1, max_length=LONGEST_TITLE, description="the name that people see beside the hash"),
    AfterValidator(line),
]
Licence = Annotated[
    str,
    Field(min_length=1, max_length=100, description="the licence that it may be used under"),
    AfterValidator(line),
]
Credit = Annotated[
    str,
    Field(min_length=1, max_length=500, description="whom to name wherever it is shown"),
    AfterValidator(line),
]


def title_of(file: PurePath) -> str:
    """The name that an upload has from its file's, if its sender says none; "" if nothing of that is left."""
    return visible(file.stem)[:LONGEST_TITLE]


class About(BaseModel):
    """What is said of an upload, which is stored with it and part of its hash; nothing of it is guessed.

    up: the axis of the file that points up; None: as its format says.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    # What is stored is read as it is: it was checked when it was sent, by the rules of its time.
    title: str | None = None
    up: Up | None = None
    licence: str | None = None
    credit: str | None = None

    def digest_part(self) -> str:
        """What the hash of an upload covers of this; nothing if nothing is said."""
        said = self.model_dump(exclude_none=True)
        return f" {json.dumps(said, sort_keys=True)}" if said else ""


NOTHING_SAID = About()
