"""The compiled kernels (C++), their build and their loading."""
