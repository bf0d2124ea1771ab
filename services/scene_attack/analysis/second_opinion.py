"""A second opinion: whether an adversary also fools the network when another renderer draws the changed scene.

The other renderer draws the scene before and after. It is given the changes of the groups that it has, too, and a scene
that has those in it which a scene can have, such as dents and colours. All else, such as the texels of a map, stays.
"""

from pkgutil import resolve_name

from torch import Tensor

from scene_attack.analysis.records import SecondOpinion
from scene_attack.analysis.transfer import Wanted, shown_to
from scene_attack.attacks.run import Verifier
from scene_attack.errors import JobFailure
from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.rendering.factory import build
from scene_attack.rendering.physical_change import listed
from scene_attack.rendering.protocol import Parameters
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.targets.protocol import Target

IMAGES = ("original", "attacked")


def image_file(renderer: str, which: str) -> str:
    """The name of the file of one of the `IMAGES` that another renderer drew."""
    return f"second_opinion_{renderer}_{which}.png"


def second_opinion(
    scene: ResolvedScene, renderer: str, perturbation: Parameters, other: str, target: Target, wanted: Wanted
) -> tuple[SecondOpinion, dict[str, Tensor]]:
    """The opinion of the renderer `other` on a perturbation of `renderer`'s groups, and its two images, uint8
    [H, W, 3], by the names of their files.

    The outcome is judged as a job's is. Where the images of `other` have noise, one that does not meet the goal under
    every seed has held. A renderer that fails loses no finished attack: the record says why there is no opinion.
    """
    own, others = RENDERERS[renderer], RENDERERS[other]
    shared = {group: change for group, change in perturbation.items() if others.draws(own.group(group))}
    inside = {g: change for g, change in perturbation.items() if g not in shared and own.group(g).of_scene}
    left = [group for group in perturbation if group not in (*shared, *inside)]
    note = f"without {listed(left)}, which {other} does not have" if left else ""
    try:
        before = after = Verifier(build(scene, other, groups=tuple(shared), tolerance="exact"), target)
        if inside:
            changed = resolve_name(str(own.remade))(scene, inside)
            after = Verifier(build(changed, other, groups=tuple(shared), tolerance="exact"), target)
        images = before.image({}), after.image(shared)
        shown = shown_to(before, wanted, *images)
        share = _share(before, after, wanted, images[0], shared)
    except JobFailure as failure:
        return SecondOpinion(renderer=other, failure=failure.detail, note=note), {}
    opinion = SecondOpinion(
        renderer=other,
        before=shown.before,
        after=shown.after,
        outcome="held" if share not in (None, 1.0) and shown.outcome in ("fooled", "changed") else shown.outcome,
        right_before=shown.right_before,
        share=share,
        note=note,
    )
    return opinion, {image_file(other, which): image for which, image in zip(IMAGES, images, strict=True)}


def _share(
    before: Verifier, after: Verifier, wanted: Wanted, original: Tensor, perturbation: Parameters
) -> float | None:
    """The share of other seeds under which the goal is met; None where the images have no noise."""
    seeds = [after.logits(to_bytes(image)) for image in after.reseeded(perturbation)]
    if not seeds:
        return None
    goal = wanted.goal(int(before.logits(original).argmax()))
    return sum(bool(goal.fooled(scores)) for scores in seeds) / len(seeds)
