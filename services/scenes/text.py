"""Text of files whose encoding is not stated."""


def decoded(data: bytes) -> str:
    """Returns text that is UTF-8 or, if it cannot be, Latin-1: names may be in any encoding."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")
