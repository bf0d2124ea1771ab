"""Trains the engine of IEP with one departure from the published network undone at a time. Writes
results/iep_departures.json.

It draws the first scenes of the recipe, as far as they are not in its folder. All variants begin with the trunk that
ships and its engine's mask of all objects, see the same batches of the same questions for the same number of steps,
with a short schedule, and answer the same questions about scenes that they were not trained on, with true programs.
The trunk was trained on these scenes too, which favours all variants alike. Seconds are of the processor.
"""

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor

from benchmarks.iep_variants import VARIANTS, Variant
from benchmarks.report import RESULTS, save
from client.settings import settings_to_run
from services.questions.answers import ANSWERS
from services.scenes.library import Library
from services.targets.iep.checkpoint import load
from services.targets.iep.engine import Engine
from services.training.iep import features
from services.training.iep.data import DataFolder, Piece, examples_of, objects_of
from services.training.iep.engine_training import Draw
from services.training.iep.examples import Example
from services.training.iep.export import SHIPPED
from services.training.iep.loop import Schedule, Step, TrainingLoop
from services.training.iep.metrics import OVERALL, Share, by_family
from services.training.iep.processes import cores
from services.training.iep.recipe import RECIPE, SHARD

AT_ONCE = 64
"""Questions that are answered together."""


def main() -> None:
    """Runs the trainings and writes the result; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("out/iep-departures"), help="of the drawn scenes")
    parser.add_argument("--shards", type=int, default=30, help="files of 100 scenes to train on (default 30)")
    parser.add_argument("--held-out", type=int, default=4, help="files of 100 scenes to answer about (default 4)")
    parser.add_argument("--steps", type=int, default=1500, help="steps of each variant (default 1500)")
    parser.add_argument("--seed", type=int, default=0, help="of the training's data, and of the variants")
    parser.add_argument("--processes", type=int, default=cores(), help="that draw scenes; default: one for each core")
    parser.add_argument("--out", type=Path, default=RESULTS / "iep_departures.json")
    options = parser.parse_args()
    torch.set_num_threads(1)
    shipped = load(SHIPPED).network
    scenes = SHARD * (options.shards + options.held_out)
    recipe = replace(RECIPE, shares={"pyrender": 1.0}, scenes={"train": scenes})
    data = DataFolder(options.folder / "data", recipe, options.seed)
    settings = settings_to_run()
    library = Library(settings.cache_dir, settings.data_dir)
    data.draw_missing(["train"], library, _say, lambda: False, options.processes)
    features.write_missing(options.folder / "features", shipped.trunk, data, "train", _say, lambda: False)
    pieces = data.pieces("train")
    held_out = Questions(data, pieces[: options.held_out], options.folder)
    training = Questions(data, pieces[options.held_out :], options.folder)
    schedule = Schedule(options.steps, RECIPE.engine.rate)
    about = {"steps": options.steps, "batch": RECIPE.engine_batch, "scenes": len(training.features)}
    rows = []
    for variant in VARIANTS:
        rows.append(_row(variant, training, held_out, shipped.engine, schedule, options.seed))
        print(rows[-1], flush=True)
        backend = f"cpu; torch {torch.__version__} 1 thread"
        save(options.out, str(__doc__).split("\n\n")[0], backend, options.seed, **about, rows=rows)


class Questions:
    """The questions about some files of scenes, with features of the images and the cells of the objects."""

    def __init__(self, data: DataFolder, pieces: list[Piece], folder: Path) -> None:
        shards = [data.read(piece) for piece in pieces]
        self.features: Tensor = torch.cat(
            [load_file(folder / "features" / data.path(piece).name)["features"] for piece in pieces]
        )
        self.examples = list(examples_of(shards))
        self.cells = [[one.cell for one in scene] for scene in objects_of(shards)]


def _say(what: str, done: float, total: float, words: str) -> None:
    print(f"{what} {done:,.0f} of {total:,.0f} {words}", flush=True)


def _row(
    variant: Variant, training: Questions, held_out: Questions, shipped: Engine, schedule: Schedule, seed: int
) -> dict[str, Any]:
    """Trains a variant and returns what it can do."""
    torch.manual_seed(seed)
    engine = variant.build()
    engine.stem.mask.load_state_dict(shipped.stem.mask.state_dict())
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        step = step_of(variant, engine, training, RECIPE.engine_batch)
        TrainingLoop(variant.name, engine, schedule, step, seed, Path(folder) / "engine").run(lambda _: None)
    seconds = time.process_time() - began
    engine.eval()
    right = [
        found == example.answer
        for found, example in zip(_answers(variant, engine, held_out), held_out.examples, strict=True)
    ]
    shares = by_family(held_out.examples, right)
    return {
        "variant": variant.name,
        "parameters": sum(parameter.numel() for parameter in engine.parameters() if parameter.requires_grad),
        "seconds": seconds,
        "overall": _written(shares.pop(OVERALL)),
        "families": {name: _written(share) for name, share in shares.items()},
    }


def step_of(variant: Variant, engine: torch.nn.Module, training: Questions, batch: int) -> Step:
    """Returns the step of a training loop, which draws the same questions for every variant."""
    draw = Draw(training.examples, batch)

    def step(progress: float, random: Any) -> tuple[Tensor, dict[str, float]]:
        chosen = [training.examples[one] for one in draw(progress, random)]
        execution = variant.execute(engine, training.features, chosen)
        loss = variant.loss(execution, chosen, [training.cells[one.image] for one in chosen])
        return loss, {"loss": float(loss.detach())}

    return step


@torch.no_grad()
def _answers(variant: Variant, engine: torch.nn.Module, of: Questions) -> list[str]:
    found: list[str] = []
    for start in range(0, len(of.examples), AT_ONCE):
        some: list[Example] = of.examples[start : start + AT_ONCE]
        scores = variant.execute(engine, of.features, some).scores
        found += [ANSWERS[number] for number in scores.argmax(1).tolist()]
    return found


def _written(share: Share) -> dict[str, Any]:
    return {"right": share.right, "of": share.of, "share": share.share, "wilson": list(share.interval)}


if __name__ == "__main__":
    main()
