"""Keeps attacks on a scene after CLEVR within scenes that exist and in which the question has the same answer.

Objects stay on the plane, upright, apart from each other, inside the frame and in view: who hides an object behind
another has not fooled the network that no longer counts it. What the question's functions find in the scene, such as
the set of the red objects, stays too: a red cube that has turned blue is no adversary of a question about red cubes,
nor is one that is about as near to purple as to red. The parameters that an attack moves are then the paper's: energy
and position of each light, and of each object its colour, its place on the plane and its turn.
"""

from collections.abc import Iterator, Sequence
from itertools import islice, product

import torch
from torch import Tensor

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.plan import Item, Plan
from scene_attack.rendering.protocol import Parameters
from scene_attack.runs.described import CAMERA, OF_OBJECTS, can_carry, described
from scene_attack.scenes.description import Scene
from scene_attack_questions.clevr.description import other_readings, record_after, rig_after, rig_of
from scene_attack_questions.clevr.generator import MIN_PIXELS, check, visible_pixels
from scene_attack_questions.clevr.records import ObjectRecord, Rig, SceneRecord
from scene_attack_questions.executor import Facts, IllPosed, Value, execute
from scene_attack_questions.program import Program

HALVINGS = 8
"""Halvings of the search for the largest share of a change that is allowed: a share is found to 1/256."""
ROLL = 3
"""The coordinate of the group `camera` that turns the camera about its viewing direction."""
MOST_READINGS = 1024
"""Readings of a scene's colours that are looked at; a scene that can be read in more ways is not allowed."""
UP = 1
"""The axis that points up: an object does not move along it, and turns about no other."""


class SceneLimits:
    """The perturbations of a job that are allowed; implements `scene_attack.attacks.limits.Constraint`.

    `initial` are the attacked groups' values.
    """

    def __init__(
        self, programs: Sequence[Program], record: SceneRecord, scene: Scene, renderer: str, initial: Parameters
    ) -> None:
        self._programs, self._record, self._scene = programs, record, scene
        self._renderer = renderer
        self._outputs = self._found(self._record)
        seen = visible_pixels(self._record.objects, rig_of(self._record))
        self._least_seen = [min(MIN_PIXELS, pixels) for pixels in seen]
        self.fixed = {group: _fixed(group, value) for group, value in initial.items()}

    def holds(self, perturbation: Parameters) -> bool:
        """Whether a perturbation leaves the objects at allowed places, and the question's results unchanged."""
        if not can_carry(self._renderer, tuple(perturbation)):
            return True
        if CAMERA in perturbation and perturbation[CAMERA][ROLL] != 0:
            return False  # CLEVR's cameras are upright, so that a record would not know of it
        scene = described(self._scene, perturbation)
        record, rig = record_after(self._record, scene), rig_after(self._record, scene.camera)
        try:
            check(record.objects, rig)
        except InvalidRequest:
            return False
        readings = list(islice(_readings(record, scene), MOST_READINGS + 1))
        if len(readings) > MOST_READINGS:
            return False
        return all(self._found(one) == self._outputs for one in readings) and self._in_view(record.objects, rig)

    def _in_view(self, placed: Sequence[ObjectRecord], rig: Rig) -> bool:
        """Whether each object is seen in as many pixels as the generator asks for, or as at the start if fewer."""
        return all(n >= least for n, least in zip(visible_pixels(placed, rig), self._least_seen, strict=True))

    def project(self, perturbation: Parameters) -> Parameters:
        """Returns a perturbation that holds: itself if it does, else one in which changes are made smaller.

        The camera is moved first, then object after object, each in turn by as much of its change as is allowed where
        the others are; lights keep theirs.
        """
        if self.holds(perturbation):
            return perturbation
        parts = list(_parts(perturbation))
        moved = {group: value.detach().clone() for group, value in perturbation.items()}
        for groups, row in parts:
            for group in groups:
                moved[group][row] = 0
        for groups, row in parts:
            share = self._share(moved, perturbation, groups, row)
            for group in groups:
                moved[group][row] = share * perturbation[group][row].detach()
        return moved

    def in_plan(self, plan: Plan) -> Plan:
        """Returns the plan with what the search leaves out."""
        items = [
            Item(
                part=group,
                what="coordinates",
                kept=int((~mask).sum()),
                of=mask.numel(),
                why=_WHY.get(group, "all are searched"),
            )
            for group, mask in self.fixed.items()
        ]
        return plan.model_copy(update={"items": (*plan.items, *items)})

    def _share(self, moved: Parameters, whole: Parameters, groups: Sequence[str], row: int | slice) -> float:
        def allowed(share: float) -> bool:
            for group in groups:
                moved[group][row] = share * whole[group][row].detach()
            return self.holds(moved)

        if allowed(1.0):
            return 1.0
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if allowed(middle) else (low, middle)
        return low

    def _found(self, record: SceneRecord) -> list[tuple[Value, ...]] | None:
        """The outputs of the functions of all questions; None if one is ill-posed."""
        facts = Facts.of(record)
        try:
            return [execute(program, facts) for program in self._programs]
        except IllPosed:
            return None


def _readings(record: SceneRecord, scene: Scene) -> Iterator[SceneRecord]:
    """The record, and the record with the colours of objects read as other names that are about as near."""
    names = [
        (thing.color, *other_readings(shown.color)) for thing, shown in zip(record.objects, scene.objects, strict=True)
    ]
    for colors in product(*names):
        both = zip(record.objects, colors, strict=True)
        yield record.model_copy(
            update={"objects": tuple(thing.model_copy(update={"color": color}) for thing, color in both)}
        )


_WHY = {
    "illumination": "the light from all around stays: the paper attacks energy and position of the lights",
    "translation": "objects stay on the plane; what overlaps, hides one, leaves the frame or changes the answer is "
    "kept out of the search",
    "rotation": "objects stay upright",
    CAMERA: "the camera stays level: left and right are its own",
    "color": "no colour that the question asks about becomes another, or nearly; the others are free",
}
"""Explanation of a group's limits in the plan."""


def _fixed(group: str, value: Tensor) -> Tensor:
    """Returns a mask of the coordinates of a group that are fixed, bool of its shape."""
    mask = torch.zeros(value.shape, dtype=torch.bool)
    if group == "illumination":
        mask[0] = True  # the ambient light is the first
    elif group == "translation":
        mask[:, UP] = True
    elif group == "rotation":
        mask[:] = True
        mask[:, UP] = False
    elif group == CAMERA:
        mask[ROLL] = True
    return mask


def _parts(perturbation: Parameters) -> Iterator[tuple[tuple[str, ...], int | slice]]:
    """Yields the parts that change together: the camera; of each object its place and turn; its colour."""
    if CAMERA in perturbation:
        yield (CAMERA,), slice(None)
    places = tuple(group for group in OF_OBJECTS if group in perturbation and group != "color")
    count = max((len(perturbation[group]) for group in OF_OBJECTS if group in perturbation), default=0)
    for k in range(count):
        for groups in (places, ("color",) if "color" in perturbation else ()):
            if groups:
                yield groups, k
