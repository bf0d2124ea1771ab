"""The commands `analyse`, which analyses a stored result, and `rerender`, the re-rendering defence of an image."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scene_attack.cli.commands.options import JsonOption
from scene_attack.cli.console import print_found, print_json, remark

if TYPE_CHECKING:
    from scene_attack.options import Options
    from scene_attack.runs.analyse import StoredAnalysis

ANALYSES = "analyses.json"


app = typer.Typer()


@app.command(
    epilog="Examples: [bold]scene-attack analyse out/combined --minimal[/bold]\n\n"
    "[bold]scene-attack analyse out/poses --coordinates --transfer efficientnet-lite0 --second-opinion torch[/bold]"
)
def analyse(
    directory: Annotated[Path, typer.Argument(help="The directory that `run --out` or `jobs download` wrote.")],
    minimal: Annotated[bool, typer.Option("--minimal", help="The smallest scale that still fools.")] = False,
    coordinates: Annotated[bool, typer.Option("--coordinates", help="Shapley values of single coordinates.")] = False,
    images: Annotated[int, typer.Option(min=4, help="Largest number of images for --coordinates.")] = 4096,
    transfer: Annotated[
        list[str] | None, typer.Option(metavar="TARGET", help="Show the image to this target; repeatable.")
    ] = None,
    second_opinion: Annotated[
        list[str] | None,
        typer.Option(metavar="RENDERER", help="Draw the changed scene with this renderer; repeatable."),
    ] = None,
    survival: Annotated[bool, typer.Option("--survival", help="Have 64 ordinary cameras take the image.")] = False,
    interpret: Annotated[bool, typer.Option("--interpret", help="Fit physical parameters to the image.")] = False,
    defend: Annotated[bool, typer.Option("--rerender", help="The re-rendering defence.")] = False,
    adaptive: Annotated[bool, typer.Option("--adaptive", help="Attack the pixels through that defence.")] = False,
    steps: Annotated[int, typer.Option(min=1, help="Steps of each fit, for --interpret and --rerender.")] = 100,
    as_json: JsonOption = False,
) -> None:
    """Analyse a stored result: which groups did it, how little is enough, and what else it fools.

    The table of subsets and the groups' Shapley values are always made; options ask for more. All of it is written to
    analyses.json in the directory.
    """
    from scene_attack.cli.tables import print_analyses, print_subsets, warn
    from scene_attack.runs.environment import options_to_run

    options = options_to_run()
    request: dict[str, Any] = {
        "minimal": {} if minimal else None,
        "coordinates": {"images": images} if coordinates else None,
        "transfer": {"targets": transfer} if transfer else None,
        "second_opinion": {"renderers": second_opinion} if second_opinion else None,
        "survival": {} if survival else None,
        "interpretation": {"steps": steps} if interpret else None,
        "rerendering": {"steps": steps} if defend else None,
        "adaptive": {} if adaptive else None,
    }
    result = _analyse(directory, request, options)
    (directory / ANALYSES).write_text(result.model_dump_json(indent=1) + "\n", "utf-8")
    warn(result.warnings)
    if as_json:
        print_json(result)
        return
    print_subsets(result.subsets, result.attribution)
    print_analyses(result.analyses)
    remark(f"Written to {directory / ANALYSES}")


def _analyse(directory: Path, request: dict[str, Any], options: "Options") -> "StoredAnalysis":
    from scene_attack.cli.commands.run import library
    from scene_attack.cli.progress import JobLine
    from scene_attack.cli.result_folder import check_finished

    check_finished(directory)
    with JobLine(str(directory)) as line:
        line.update("loading", 0, 1, None)
        assets = library(options)
        from scene_attack.analysis.records import AnalysisRequest
        from scene_attack.runs.analyse import analyse_stored

        return analyse_stored(
            directory,
            AnalysisRequest.model_validate(request),
            assets,
            lambda name, done, of: line.update(name, done, of, None),
        )


@app.command(
    epilog="Example: [bold]scene-attack rerender out/image/attacked.png examples/image-fgsm.json "
    "--out rendered.png[/bold]"
)
def rerender(
    image: Annotated[Path, typer.Argument(help="An image of the scene, of the camera's size.")],
    spec: Annotated[str, typer.Argument(metavar="SPEC", help="A job as JSON, for scene and target; - reads stdin.")],
    out: Annotated[Path | None, typer.Option(help="Write the rendering to this PNG file.")] = None,
    steps: Annotated[int, typer.Option(min=1, max=10_000, help="Steps of the fit.")] = 100,
    rate: Annotated[float, typer.Option(help="Learning rate of the fit.")] = 1e-3,
    optimiser: Annotated[str, typer.Option(help="Optimiser of the fit: adam or sgd.")] = "adam",
    as_json: JsonOption = False,
) -> None:
    """Defend a network by re-rendering: fit the scene to an image, and classify the fitted scene's rendering instead.

    The exit code is 0 whatever the network says.
    """
    from pydantic import ValidationError

    from scene_attack.analysis.records import RerenderingRequest
    from scene_attack.cli.commands.run import library
    from scene_attack.cli.progress import JobLine
    from scene_attack.cli.specs import read_job
    from scene_attack.cli.tables import rerendering_table
    from scene_attack.errors import InvalidFields, InvalidRequest
    from scene_attack.runs.environment import options_to_run
    from scene_attack.runs.field_errors import in_words

    options = options_to_run()
    job = read_job(spec, options)
    try:
        request = RerenderingRequest.model_validate({"steps": steps, "rate": rate, "optimiser": optimiser})
    except ValidationError as error:
        wrong = [InvalidRequest(f"--{entry['loc'][0]}", in_words(entry)) for entry in error.errors()]
        raise InvalidFields(wrong) from error
    with JobLine(image.name) as line:
        line.update("loading", 0, 1, None)
        assets = library(options)
        from scene_attack.analysis.images import load_png, save_png
        from scene_attack.runs.analyse import rerender_image

        try:
            pixels = load_png(image)
        except OSError as error:
            raise InvalidRequest("IMAGE", f"cannot read {image}: {error}") from error
        record, rendered = rerender_image(
            pixels, job, request, assets, lambda done, of: line.update("fitting", done, of, None)
        )
    if out is not None:
        save_png(rendered, out)
    print_found(record, rerendering_table(record), as_json)
