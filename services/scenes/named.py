"""A file that a mesh file or a material library names."""

from typing import NamedTuple


class Named(NamedTuple):
    """A file that another names: its name, and what it is to it."""

    name: str
    what: str

    @property
    def is_shown(self) -> bool:
        """Whether meshes other than glTF are drawn with it: of the maps only the texture is."""
        return self.what in ("material library", "texture", "buffer")
