"""Trains IEP: the trunk on the places and attributes of objects, the engine and the program generator on questions."""
