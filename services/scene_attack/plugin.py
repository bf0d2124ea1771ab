"""What a plug-in is written with: the names of this module keep their meaning while `INTERFACE` is the same.

A plug-in's module is imported by every process that reads requests, among them the API, which does without torch:
neither does this module import it, nor should a plug-in before it renders or attacks.
"""

from scene_attack.attacks.attack import Attack
from scene_attack.attacks.attack import register as register_attack
from scene_attack.plugins import INTERFACE
from scene_attack.rendering.declaration import BuildRequest, Declaration, DeclaredRenderer, Group, labelled
from scene_attack.rendering.declaration import register as register_renderer
from scene_attack.rendering.plan import Item, Plan
from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.rendering.pyrender.path_traced import path_traced
from scene_attack.runs.task import register_task
from scene_attack.runs.task_parts import Ask, Cases, Member, Part, ResultPart
from scene_attack.scenes.source import Source, register_source
from scene_attack.targets.architectures import register_architecture
from scene_attack.targets.info import TargetInfo
from scene_attack.targets.info import register as register_target

__all__ = [
    "INTERFACE",
    "PYRENDER",
    "Ask",
    "Attack",
    "BuildRequest",
    "Cases",
    "Declaration",
    "DeclaredRenderer",
    "Group",
    "Item",
    "Member",
    "Part",
    "Plan",
    "ResultPart",
    "Source",
    "TargetInfo",
    "labelled",
    "path_traced",
    "register_architecture",
    "register_attack",
    "register_renderer",
    "register_source",
    "register_target",
    "register_task",
]
