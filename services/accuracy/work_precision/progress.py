"""What a long measurement has found so far, in a file, so that it goes on where it was stopped."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel

Row = TypeVar("Row", bound=BaseModel)


class Progress:
    """Rows by key, one JSON line each, behind a first line that says what is measured.

    A file whose first line differs (other extent, versions or backend) is of another measurement and is begun anew.
    """

    def __init__(self, path: Path | None = None, about: str = "", on_step: Callable[[str], None] = lambda _: None):
        """`path` None keeps nothing. `on_step` is called with the key of each measurement that starts."""
        self._path, self._on_step, self._found = path, on_step, dict[str, list[object]]()
        if path is None:
            return
        head = json.dumps({"about": about}, ensure_ascii=False)
        lines = path.read_text("utf-8").splitlines() if path.exists() else []
        if lines[:1] != [head]:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(head + "\n", "utf-8")
            return
        for line in lines[1:]:
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:  # the last line, cut when the process ended
                break
            self._found[entry["key"]] = entry["rows"]
        kept = [json.dumps({"key": key, "rows": rows}, ensure_ascii=False) for key, rows in self._found.items()]
        path.write_text("\n".join([head, *kept]) + "\n", "utf-8")

    def rows(self, key: str, kind: type[Row], measure: Callable[[], Sequence[Row]]) -> list[Row]:
        """The rows of this key: those of the file, or else those that `measure` returns, which the file then has."""
        if key in self._found:
            return [kind.model_validate(row) for row in self._found[key]]
        self._on_step(key)
        rows = list(measure())
        if self._path is not None:
            entry = {"key": key, "rows": [row.model_dump(mode="json") for row in rows]}
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry, ensure_ascii=False, allow_nan=False) + "\n")
        return rows

    def finish(self) -> None:
        """Deletes the file: the report has everything."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)
