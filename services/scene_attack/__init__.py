"""Finds out how a vision model fails when the scene changes a little: its light, a surface, a colour, a pose.

import scene_attack as sa

scene = sa.Scene(objects=[sa.Object(mesh="./chair.glb", material="plastic")])
target = sa.target(module, labels=["chair", "table"])
result = sa.attack(scene, target, sa.FGSM(renderer="torch"), goal=sa.Goal(truth="chair"))
print(result.verified, result.attacked.label)
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scene_attack.attacks.apgd import APGD
    from scene_attack.attacks.attack import Attack
    from scene_attack.attacks.cma_es import CMAES
    from scene_attack.attacks.fgsm import FGSM
    from scene_attack.attacks.mi_fgsm import MIFGSM
    from scene_attack.attacks.natural_gradient import NaturalGradient
    from scene_attack.attacks.p_rgf import PRGF
    from scene_attack.attacks.request import Expectation
    from scene_attack.attacks.spsa import SPSA
    from scene_attack.attacks.square import Square
    from scene_attack.attacks.zoo import ZOO
    from scene_attack.client.client import AsyncClient, AsyncJob, Client, Job, images
    from scene_attack.client.errors import ApiError, Unfinished
    from scene_attack.errors import InvalidRequest, JobFailure
    from scene_attack.objects import CampaignRun, Result, attack, campaign, load, renderer, target, truth
    from scene_attack.options import Options
    from scene_attack.rendering.protocol import Renderer
    from scene_attack.runs.campaign_spec import CampaignSpec as Campaign
    from scene_attack.runs.campaign_spec import Grid
    from scene_attack.runs.spec import Goal
    from scene_attack.runs.spec import JobSpec as Spec
    from scene_attack.scenes.description import Camera, Environment, Floor, Lights, PointLight, Scene
    from scene_attack.scenes.description import SceneObject as Object
    from scene_attack.scenes.mesh_arrays import MeshArrays as Mesh
    from scene_attack.targets.custom.card import Preprocessing
    from scene_attack.targets.protocol import Target

__all__ = [
    "APGD",
    "CMAES",
    "FGSM",
    "MIFGSM",
    "PRGF",
    "SPSA",
    "ZOO",
    "ApiError",
    "AsyncClient",
    "AsyncJob",
    "Attack",
    "Camera",
    "Campaign",
    "CampaignRun",
    "Client",
    "Environment",
    "Expectation",
    "Floor",
    "Goal",
    "Grid",
    "InvalidRequest",
    "Job",
    "JobFailure",
    "Lights",
    "Mesh",
    "NaturalGradient",
    "Object",
    "Options",
    "PointLight",
    "Preprocessing",
    "Renderer",
    "Result",
    "Scene",
    "Spec",
    "Square",
    "Target",
    "Unfinished",
    "attack",
    "campaign",
    "images",
    "load",
    "renderer",
    "target",
    "truth",
]

# OpenMP threads spin at every barrier by default. With more busy threads than cores, as beside other workers, that cost
# torch a factor of 10 to 30 (measured, 2 threads on 2 shared cores). Read when torch is loaded, so set here, before.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

_PLACES = {
    **dict.fromkeys(("Scene", "Camera", "Lights", "PointLight", "Environment", "Floor"), "scenes.description"),
    "Object": "scenes.description:SceneObject",
    "Mesh": "scenes.mesh_arrays:MeshArrays",
    "Target": "targets.protocol",
    "Preprocessing": "targets.custom.card",
    "FGSM": "attacks.fgsm",
    "MIFGSM": "attacks.mi_fgsm",
    "APGD": "attacks.apgd",
    "ZOO": "attacks.zoo",
    "SPSA": "attacks.spsa",
    "Square": "attacks.square",
    "PRGF": "attacks.p_rgf",
    "CMAES": "attacks.cma_es",
    "NaturalGradient": "attacks.natural_gradient",
    "Attack": "attacks.attack",
    "Goal": "runs.spec",
    "Expectation": "attacks.request",
    "Renderer": "rendering.protocol",
    **dict.fromkeys(("target", "renderer", "attack", "Result", "load", "truth", "campaign", "CampaignRun"), "objects"),
    "Spec": "runs.spec:JobSpec",
    "Campaign": "runs.campaign_spec:CampaignSpec",
    "Grid": "runs.campaign_spec",
    "Options": "options",
    **dict.fromkeys(("InvalidRequest", "JobFailure"), "errors"),
    **dict.fromkeys(("Client", "AsyncClient", "Job", "AsyncJob", "images"), "client.client"),
    **dict.fromkeys(("ApiError", "Unfinished"), "client.errors"),
}
"""The module of each name; "module:name" where it is defined under another name."""


def __getattr__(name: str) -> Any:
    """Imports what is asked for: importing the package takes none of it."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, defined = _PLACES[name].partition(":")
    return getattr(import_module(f"{__name__}.{module}"), defined or name)


def __dir__() -> list[str]:
    return __all__
