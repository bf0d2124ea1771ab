"""Questions about CLEVR scenes: the functions of their programs, an executor, templates, wording, and their files."""
