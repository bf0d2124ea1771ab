"""What people say of a file that they upload: its name, which way is up, and whose it is."""

import json
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

PRINTABLE = r"^[^\x00-\x1f\x7f-\x9f]*$"
"""Text of one line, without the characters that steer a terminal."""
Up = Literal["y", "z"]
Title = Annotated[
    str, Field(min_length=1, max_length=100, pattern=PRINTABLE, description="the name that people see beside the hash")
]
Licence = Annotated[
    str, Field(min_length=1, max_length=100, pattern=PRINTABLE, description="the licence that it may be used under")
]
Credit = Annotated[
    str, Field(min_length=1, max_length=500, pattern=PRINTABLE, description="whom to name wherever it is shown")
]


class About(BaseModel):
    """What is said of an upload, which is stored with it and part of its hash; nothing of it is guessed.

    up: the axis of the file that points up; None: as its format says.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    title: Title | None = None
    up: Up | None = None
    licence: Licence | None = None
    credit: Credit | None = None

    def digest_part(self) -> str:
        """What the hash of an upload covers of this; nothing if nothing is said."""
        said = self.model_dump(exclude_none=True)
        return f" {json.dumps(said, sort_keys=True)}" if said else ""


NOTHING_SAID = About()
