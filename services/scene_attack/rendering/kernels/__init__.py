"""The compiled kernels (C++), the choice among them, and their loading."""
