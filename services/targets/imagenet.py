"""The 1,000 ImageNet-1k classes, in the order every published network uses."""

from functools import lru_cache
from importlib.resources import files


@lru_cache(maxsize=1)
def imagenet_labels() -> tuple[str, ...]:
    """Returns the label names: the first WordNet lemma of each synset, made unique where two synsets share it."""
    lines = files("services.targets").joinpath("imagenet.tsv").read_text("utf-8").splitlines()
    return tuple(line.split("\t")[1] for line in lines)
