"""What an XML file that is not trusted may not have, and the names in it, found without parsing it."""

import re
from collections.abc import Iterator

from services.scenes.named import Named
from services.scenes.unreadable import Unreadable

_ENCODINGS = (b"utf-8", b"us-ascii", b"ascii", b"iso-8859-1", b"windows-1252")
_SLOTS = {
    "diffuse": "texture",
    "emission": "emission map",
    "ambient": "ambient map",
    "specular": "specular map",
    "reflective": "reflection map",
    "transparent": "opacity map",
    "bump": "bump map",
    "normal": "normal map",
}
"""What an image is to an effect of COLLADA that has it in a slot. Only the first is shown."""

_INIT_FROM = re.compile(r"<init_from>([^<]*)(?:<ref>([^<]*))?")
_SOURCE = re.compile(r"<(?:source|init_from)>([^<]*)|<instance_image\s+url=\"#([^<\"]*)\"")


def check_xml(data: bytes) -> None:
    """Raises Unreadable for a document type, which is where entities are declared, or an unusual encoding.

    Entities can name files and addresses, and a few of them stand for gigabytes; another encoding would hide them.
    """
    if b"\0" in data or data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise Unreadable("its text is not UTF-8")
    declared = re.match(rb"[\xef\xbb\xbf\s]*<\?xml[^>]*?encoding\s*=\s*[\"']([^\"']*)", data)
    if declared and declared[1].lower() not in _ENCODINGS:
        raise Unreadable(f"its encoding is {declared[1][:40].decode('latin-1')!r}; UTF-8 is read")
    if re.search(rb"<!\s*(?:DOCTYPE|ENTITY)", data, re.IGNORECASE):
        raise Unreadable("it declares a document type or entities, which are not read")


def collada_images(data: bytes) -> list[Named]:
    """Returns the image files that a COLLADA file names: those that effects use, and then the others."""
    text = data.decode("utf-8", "replace")
    files = {}
    for head, body in _elements(text, "image"):
        name, found_file = _attribute(head, "id"), _INIT_FROM.search(body)
        file = "" if found_file is None else (found_file[1].strip() or (found_file[2] or "").strip())
        if name and file:
            files[name] = _unescaped(file)
    found = []
    for _, effect in _elements(text, "effect"):
        params = {}
        for head, body in _elements(effect, "newparam"):
            name, source = _attribute(head, "sid"), _SOURCE.search(body)
            if name and source:
                params[name] = (source[1] or source[2] or "").strip()
        for slot, what in _SLOTS.items():
            for used in re.findall(rf"<{slot}\b[^<>]*>\s*<texture\b[^<>]*?\btexture=\"([^<\"]+)\"", effect):
                image = used
                for _ in range(3):
                    image = params.get(image, image)
                if image in files:
                    found.append(Named(files[image], what))
    named = {one.name for one in found}
    return [*found, *(Named(name, "image") for name in files.values() if name not in named)]


def _elements(text: str, name: str) -> Iterator[tuple[str, str]]:
    """Yields the attributes and the content of each element of a name that has an end.

    It looks at every character a few times at most. An expression that looks for the end of each beginning takes
    minutes for a file of beginnings alone.
    """
    for begins in text.split(f"</{name}>")[:-1]:
        start = re.search(rf"<{name}\b([^<>]*)>", begins)
        if start:
            yield start[1], begins[start.end() :]


def _attribute(head: str, name: str) -> str | None:
    found = re.search(rf"\b{name}=\"([^\"]+)\"", head)
    return None if found is None else found[1]


def _unescaped(text: str) -> str:
    for written, meant in (("&lt;", "<"), ("&gt;", ">"), ("&quot;", '"'), ("&apos;", "'"), ("&amp;", "&")):
        text = text.replace(written, meant)
    return text.removeprefix("file:///").removeprefix("file://")
