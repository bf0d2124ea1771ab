"""The networks of a job as files of an export: what they are and where they come from, but not their weights.

`targets/<name>.json` is an `ExportedTarget`. For a network that a user brings in a file, `targets/<name>/` has its card
and its labels: it is the folder that `SCENE_ATTACK_TARGETS` would have, once the model file is put into it.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, Field, ValidationError

from scene_attack.errors import InvalidRequest
from scene_attack.plugins import NAME, loaded_plugins
from scene_attack.runs.result import Result
from scene_attack.runs.set_up import CARD, MODEL_FILES, register_folder
from scene_attack.runs.spec import JobSpec
from scene_attack.scenes.exported_assets import check_plain
from scene_attack.targets.custom.card import AllowList
from scene_attack.targets.info import TARGETS, TargetInfo

FOLDER = "targets"
"""The folder in an export."""


class ExportedTarget(BaseModel):
    """A network of a job, in an export."""

    name: str = Field(pattern=f"^{NAME.pattern}$")
    card: TargetInfo | None = Field(description="its card; null if the network was not known where this was exported")
    weights_sha256: str = Field(description="SHA-256 (hex) of its weights, as `result.json` has it")
    model_file: Literal["model.pt2", "model.onnx", "model.safetensors"] | None = Field(
        description="the file of a user's own network to put into the folder of this name; null for other networks"
    )
    plugins: dict[str, str] = Field(
        description="name and version to SHA-256 of the module of the plug-in that registers the network; install it"
    )

    def missing(self, folder: str) -> str | None:
        """Returns a sentence about what another machine lacks to load the network; None if scene-attack comes with it.

        `folder` is the path of the folder `targets` of the export, as the sentence is to name it.
        """
        if self.model_file is not None:
            return (
                f"the weights of the network {self.name!r} are not in the export: put {self.model_file}, whose SHA-256 "
                f"is {self.weights_sha256}, into {folder}/{self.name}"
            )
        if self.plugins:
            packages = ", ".join(f"{name} (SHA-256 {sha256})" for name, sha256 in self.plugins.items())
            return f"the network {self.name!r} is registered by the plug-in {packages}: install it"
        if self.card is not None and self.card.card_sha256 is None:
            return None
        return (
            f"the network {self.name!r} is not in the export: install a target of this name whose weights have the "
            f"SHA-256 {self.weights_sha256} (docs/targets.md)"
        )


def exported_targets(result: Result, spec: JobSpec) -> list[ExportedTarget]:
    """Returns the network under attack and then the surrogate, if there is one."""
    weights = {spec.target.name: result.provenance.weights_sha256}
    if spec.attack.guide is not None and result.provenance.surrogate_sha256 is not None:
        weights[spec.attack.guide] = result.provenance.surrogate_sha256
    return [_exported(name, sha256, result) for name, sha256 in weights.items()]


def _exported(name: str, weights_sha256: str, result: Result) -> ExportedTarget:
    known = TARGETS.get(name)
    used = result.provenance.plugins
    return ExportedTarget(
        name=name,
        card=None if known is None else known.info,
        weights_sha256=weights_sha256,
        model_file=None if known is None or known.model_file is None else known.model_file.name,
        plugins={
            plugin.package: used[plugin.package]
            for plugin in loaded_plugins()
            if plugin.package in used and ("target", name) in plugin.adds
        },
    )


def write_targets(targets: list[ExportedTarget], write: Callable[[str, bytes], None]) -> None:
    """Calls `write` with the path and the bytes of each file."""
    for target in targets:
        write(f"{FOLDER}/{target.name}.json", target.model_dump_json(indent=1).encode() + b"\n")
        known = TARGETS.get(target.name)
        # The card of a factory or an endpoint names what is private to the machine that has it.
        for file in () if known is None or known.model_file is None else known.card_files:
            write(f"{FOLDER}/{target.name}/{file.name}", file.read_bytes())


def register_exported(export: Path) -> None:
    """Registers the networks of an export: those whose model file was put into it, in place of this machine's.

    Raises InvalidRequest("directory"), which says what is missing and where it goes.
    """
    if not (export / FOLDER).is_dir():
        return
    check_plain(export / FOLDER)
    for file in sorted((export / FOLDER).glob("*.json")):
        try:
            target = ExportedTarget.model_validate_json(file.read_bytes())
        except ValidationError as error:
            raise InvalidRequest("directory", f"{file} is damaged") from error
        folder = file.with_suffix("")
        if (folder / CARD).is_file() and any((folder / name).is_file() for name in MODEL_FILES):
            # What somebody put into the export is meant, whatever this machine calls by the same name.
            TARGETS.restore({name: declared for name, declared in TARGETS.snapshot().items() if name != target.name})
            reason = register_folder(folder, AllowList()).error
            if reason is not None:
                raise InvalidRequest("directory", f"the network in {folder} cannot be used: {reason}")
        elif target.name not in TARGETS and (missing := target.missing(str(export / FOLDER))) is not None:
            raise InvalidRequest("directory", missing)
