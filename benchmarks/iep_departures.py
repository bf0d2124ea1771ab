"""Trains the engine of IEP with one departure from the published network undone at a time. Writes
results/iep_departures.json.

It reads the folder of a training that has finished its trunk (`scene-attack train iep`) and writes nothing there. All
variants see the same batches of the same questions for the same number of steps, with a short schedule, and answer the
same questions about scenes that no engine was trained on, with true programs. The trunk was trained on these scenes
too, which favours all variants alike. Seconds are of the processor.
"""

import argparse
import tempfile
import time
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor

from benchmarks.iep_variants import VARIANTS, Variant
from benchmarks.report import RESULTS, save
from services.questions.answers import ANSWERS
from services.training.iep.data import DataFolder, Piece, examples_of, objects_of
from services.training.iep.engine_training import Draw
from services.training.iep.examples import Example
from services.training.iep.loop import Schedule, Step, TrainingLoop
from services.training.iep.metrics import OVERALL, Share, by_family
from services.training.iep.recipe import RECIPE
from services.training.iep.trunk_training import ObjectFinder, hand_over

AT_ONCE = 64
"""Questions that are answered together."""


def main() -> None:
    """Runs the trainings and writes the result; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("out/training/iep"), help="of the training")
    parser.add_argument("--shards", type=int, default=40, help="files of 100 scenes to train on (default 40)")
    parser.add_argument("--held-out", type=int, default=4, help="files of 100 scenes to answer about (default 4)")
    parser.add_argument("--steps", type=int, default=1500, help="steps of each variant (default 1500)")
    parser.add_argument("--seed", type=int, default=0, help="of the training's data, and of the variants")
    parser.add_argument("--out", type=Path, default=RESULTS / "iep_departures.json")
    options = parser.parse_args()
    torch.set_num_threads(1)
    data = DataFolder(options.folder / "data", RECIPE, options.seed)
    pieces = _with_features(data, options.folder / "features", options.shards + options.held_out)
    held_out = Questions(data, pieces[: options.held_out], options.folder)
    training = Questions(data, pieces[options.held_out :], options.folder)
    finder = ObjectFinder()
    finder.load_state_dict(torch.load(options.folder / "trunk.checkpoint", weights_only=True)["module"])
    schedule = Schedule(options.steps, RECIPE.engine.rate)
    about = {"steps": options.steps, "batch": RECIPE.engine_batch, "scenes": len(training.features)}
    rows = []
    for variant in VARIANTS:
        rows.append(_row(variant, training, held_out, finder, schedule, options.seed))
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


def _with_features(data: DataFolder, folder: Path, count: int) -> list[Piece]:
    """Returns the first pieces of the training split that the trunk's features are there of."""
    there = (piece for piece in data.pieces("train") if (folder / data.path(piece).name).is_file())
    found = list(islice(there, count))
    if len(found) < count:
        raise SystemExit(f"{folder} has features of {len(found)} files; {count} are needed: train the trunk first")
    return found


def _row(
    variant: Variant, training: Questions, held_out: Questions, finder: ObjectFinder, schedule: Schedule, seed: int
) -> dict[str, Any]:
    """Trains a variant and returns what it can do."""
    torch.manual_seed(seed)
    engine = variant.build()
    hand_over(finder, engine)
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
