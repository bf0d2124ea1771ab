"""Who may send a request, and what of it is accepted before it is parsed."""
