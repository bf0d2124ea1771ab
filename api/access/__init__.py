"""Access: checks of the sender of a request, and of the request before it is parsed."""
