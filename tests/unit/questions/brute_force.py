"""The meaning of a program as predicate logic over a scene's JSON, read off the definitions of CLEVR's functions.

Relations come from coordinates and directions. An object is "the" one of a set if it is in the set and no other is.
"""

from functools import cache

ILL_POSED = "ill-posed"


def meaning(program: list[dict], scene: dict) -> str:
    """The answer to a program (as in CLEVR's files) about a scene (as in CLEVR's files), or ILL_POSED."""
    domain = range(len(scene["objects"]))

    def attribute(o: int, function: str) -> str:
        return scene["objects"][o][function.split("_")[1]]

    def lies(o: int, direction: str, p: int) -> bool:
        along = scene["directions"][direction]
        here, there = scene["objects"][p]["3d_coords"], scene["objects"][o]["3d_coords"]
        return sum((b - a) * d for a, b, d in zip(here, there, along, strict=True)) > 0.2

    @cache
    def belongs(o: int, k: int) -> bool:
        """Object o is in the set of node k."""
        node = program[k]
        function, inputs = node["function"], node["inputs"]
        if function == "scene":
            return True
        if function.startswith("filter_"):
            return belongs(o, inputs[0]) and attribute(o, function) == node["value_inputs"][0]
        if function == "relate":
            return any(the(p, inputs[0]) and lies(o, node["value_inputs"][0], p) for p in domain)
        if function.startswith("same_"):
            return any(
                the(p, inputs[0]) and o != p and attribute(o, function) == attribute(p, function) for p in domain
            )
        among = [belongs(o, j) for j in inputs]
        return {"union": any, "intersect": all}[function](among)

    @cache
    def the(o: int, k: int) -> bool:
        """Object o is the only one in the set that node k, a `unique`, takes."""
        (source,) = program[k]["inputs"]
        return belongs(o, source) and not any(belongs(p, source) for p in domain if p != o)

    def value(k: int) -> str | int | bool:
        function, inputs = program[k]["function"], program[k]["inputs"]
        if function == "count":
            return sum(1 for o in domain if belongs(o, inputs[0]))
        if function == "exist":
            return not all(not belongs(o, inputs[0]) for o in domain)
        if function.startswith("query_"):
            return next(attribute(o, function) for o in domain if the(o, inputs[0]))
        left, right = map(value, inputs)
        return (
            left < right if function == "less_than" else left > right if function == "greater_than" else left == right
        )

    if any(node["function"] == "unique" and not any(the(o, k) for o in domain) for k, node in enumerate(program)):
        return ILL_POSED
    found = value(len(program) - 1)
    return {True: "yes", False: "no"}[found] if isinstance(found, bool) else str(found)
