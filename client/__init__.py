"""The command line, the HTTP client, and `attack`, which attacks a network of the caller's own process."""

from client.in_process import attack

__all__ = ["attack"]
