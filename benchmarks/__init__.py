"""Side-by-side measurements; each writes the result file that the docs quote."""
