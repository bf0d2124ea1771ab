"""The command `targets convert-clevr-iep`: the released weights of IEP as a folder of SCENE_ATTACK_TARGETS."""

from pathlib import Path
from typing import Annotated

import typer

EXAMPLE = (
    "Example: [bold]scene-attack targets convert-clevr-iep --engine execution_engine_18k.pt "
    "--generator program_generator_18k.pt --trunk resnet101-63fe2227.pth --out mine/clevr-iep[/bold]"
)
_FILE = {"exists": True, "dir_okay": False}


def convert(
    engine: Annotated[
        Path, typer.Option(help="Checkpoint of the execution engine, such as execution_engine_18k.pt.", **_FILE)
    ],
    generator: Annotated[Path, typer.Option(help="Checkpoint of the program generator.", **_FILE)],
    trunk: Annotated[Path, typer.Option(help="torchvision's ResNet-101 of 2016, resnet101-63fe2227.pth.", **_FILE)],
    out: Annotated[Path, typer.Option(help="The folder to write, whose name is the target's.")],
    any_trunk: Annotated[bool, typer.Option("--any-trunk", help="Accept a trunk of another SHA-256.")] = False,
) -> None:
    """Convert the weights that clevr-iep (Johnson et al. 2017) released, for SCENE_ATTACK_TARGETS.

    The files are pickles. They are read by torch's reader of weights, which builds tensors, lists, dictionaries, texts
    and numbers and refuses everything else, and in this process only: the service reads what is written here.
    """
    from client.clevr_iep import write
    from client.console import err
    from client.console import out as stdout

    with err().status("converting"):
        written = write(engine, generator, trunk, out, any_trunk)
    stdout().print(f"written to {written}", markup=False, highlight=False, soft_wrap=True)
