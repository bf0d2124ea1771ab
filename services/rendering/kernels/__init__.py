"""The compiled inner loops (C++), their build and their loading."""
