"""One module per group of commands. Heavy modules are imported inside the functions, so that --help is quick."""
