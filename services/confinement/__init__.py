"""Takes rights from the running process before it reads bytes that are not trusted (Linux)."""
