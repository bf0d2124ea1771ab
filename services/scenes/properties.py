"""Reads and writes Java's .properties format, without its XML variant."""

import re
from collections.abc import Iterator, Mapping

_ESCAPES = {"t": "\t", "n": "\n", "r": "\r", "f": "\f"}


def parse_properties(data: bytes) -> dict[str, str]:
    """Returns the keys and values of a .properties file.

    The file is Latin-1 with backslash escapes, continued lines, and comments that begin with `#` or `!`.
    A repeated key keeps its last value. A malformed backslash-u escape is kept as written.
    """
    values: dict[str, str] = {}
    for line in _logical_lines(data.decode("latin-1")):
        match = re.match(r"((?:\\.|[^\\=:\s])*)[ \t\f]*[=:]?[ \t\f]*(.*)", line, re.DOTALL)
        assert match is not None  # every part may be empty
        values[_unescape(match[1])] = _unescape(match[2])
    return values


def write_properties(values: Mapping[str, str]) -> bytes:
    """Returns a .properties file, which `parse_properties` reads; keys have neither blanks nor `:`, `=` or a backslash,
    and values neither begin nor end with blanks.
    """
    return "".join(f"{key}={_escaped(value)}\n" for key, value in values.items()).encode("ascii")


def _escaped(text: str) -> str:
    return "".join(c if " " <= c <= "~" and c != "\\" else f"\\u{ord(c):04x}" for c in text)


def _logical_lines(text: str) -> Iterator[str]:
    lines = iter(re.split(r"\r\n|\r|\n", text))
    for raw in lines:
        line = raw.lstrip(" \t\f")
        if not line or line[0] in "#!":
            continue
        # An odd number of backslashes at the end continues the line.
        while (len(line) - len(line.rstrip("\\"))) % 2:
            line = line[:-1] + next(lines, "").lstrip(" \t\f")
        yield line


def _unescape(text: str) -> str:
    def one(match: re.Match[str]) -> str:
        if match[1]:
            return chr(int(match[1], 16))
        return _ESCAPES.get(match[2], match[2])

    return re.sub(r"\\(?:u([0-9a-fA-F]{4})|(.))", one, text, flags=re.DOTALL)
