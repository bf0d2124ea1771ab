"""What is true in a scene, as the executor asks it: the objects with each value, and those in each relation."""

from dataclasses import dataclass

from services.scenes.clevr.records import ATTRIBUTES, RELATIONS, SceneRecord

Objects = frozenset[int]
"""Indices of objects of a scene."""


@dataclass(frozen=True)
class Facts:
    """The truth about a scene. Objects are their indices in its record.

    `values[attribute][k]` is a value of object k, `having[attribute, value]` are the objects with a value, and
    `related[relation][k]` the objects that have a relation to object k.
    """

    everything: Objects
    values: dict[str, tuple[str, ...]]
    having: dict[tuple[str, str], Objects]
    related: dict[str, tuple[Objects, ...]]

    @classmethod
    def of(cls, record: SceneRecord) -> "Facts":
        """Returns the facts in a scene's record; relations are those that stand in it."""
        values = {name: tuple(one.value(name) for one in record.objects) for name in ATTRIBUTES}
        return cls(
            everything=frozenset(range(len(record.objects))),
            values=values,
            having={
                (name, value): frozenset(k for k, found in enumerate(values[name]) if found == value)
                for name, known in ATTRIBUTES.items()
                for value in known
            },
            related={name: tuple(frozenset(row) for row in record.relationships[name]) for name in RELATIONS},
        )

    def same(self, attribute: str, k: int) -> Objects:
        """Returns the other objects that share object k's value of an attribute."""
        return self.having[attribute, self.values[attribute][k]] - {k}
