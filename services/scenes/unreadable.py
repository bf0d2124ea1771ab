"""The error of a file that cannot be read."""

DAMAGED = "it is damaged, or cut off"
"""What is said where a parser that is not ours stops: its own words are about itself, not about the file."""


class Unreadable(ValueError):
    """A file, or a part of it, is not what it should be; the message says why, in words for whoever made the file."""
