"""Compares a batch of 64 questions of mixed programs with the same questions one at a time. Writes
results/questions.json.

The network is IEP's with random weights, on which the time does not depend; images are random. The questions are
those that are generated about one scene. Cases: the engine on the features of one image and of 64 images, scores alone
and with the gradient with respect to the features; and trunk and engine on one image. Both ways assemble the programs
anew. They take turns, with the allocator settings of a job's process. Seconds are the shortest of the rounds, by the
clock; ratios are medians over the rounds, by the clock and by the processor, because the speed of a shared machine
changes from second to second.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import torch
from torch import Tensor

from benchmarks.report import RESULTS, save
from client.settings import settings_to_run
from services.jobs.child import ALLOCATOR
from services.questions.generator import QuestionGenerator
from services.questions.program import Program
from services.scenes.clevr.generator import generate
from services.targets.iep.assembly import Question, assemble
from services.targets.iep.engine import Network

SEED = 0
COUNT = 64
LEAST = 4.0
"""Smallest ratio of the times that the project accepts."""


def main() -> None:
    """Runs the measurements and writes the result; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5, help="rounds (default 5)")
    parser.add_argument("--note", default="", help="a remark on the circumstances, kept in the result")
    parser.add_argument("--out", type=Path, default=RESULTS / "questions.json")
    options = parser.parse_args()
    if any(os.environ.get(name) != value for name, value in ALLOCATOR.items()):
        os.execve(sys.executable, [sys.executable, "-m", "benchmarks.questions", *sys.argv[1:]], os.environ | ALLOCATOR)
    settings = settings_to_run()
    torch.set_num_threads(settings.threads)
    torch.manual_seed(SEED)
    network = Network().eval().requires_grad_(False)
    programs = mixed(COUNT, SEED)
    image = torch.rand(1, 240, 320, 3)
    features = torch.randn(COUNT, 96, 15, 20)
    rows = [
        _compare("engine, one image", network.engine, features[:1], programs, False, options.repeats),
        _compare("engine, one image, with gradient", network.engine, features[:1], programs, True, options.repeats),
        _compare("engine, an image each", network.engine, features, programs, False, options.repeats),
        _compare("engine, an image each, with gradient", network.engine, features, programs, True, options.repeats),
        _compare("trunk and engine, one image", network, image, programs, False, max(1, options.repeats // 2)),
    ]
    for row in rows:
        print(row)
    nodes = sum(len(program.nodes) for program in programs) / len(programs)
    about = {"questions": len(programs), "mean_nodes": nodes, "least": LEAST, "note": options.note, "rows": rows}
    backend = f"cpu; torch {torch.__version__} {torch.get_num_threads()} threads"
    save(options.out, str(__doc__).split("\n\n")[0], backend, SEED, **about)


def mixed(count: int, seed: int) -> list[Program]:
    """Returns the programs of different questions about one scene, of all families in turn."""
    asked = QuestionGenerator(seed).ask(generate(seed, 0), count)
    return [question.program for question in asked if question.program is not None]


def _compare(
    case: str, module: torch.nn.Module, inputs: Tensor, programs: list[Program], gradient: bool, repeats: int
) -> dict[str, object]:
    """Measures both ways; `inputs` are of one image, or of an image for each program."""

    def run(own: Tensor, questions: list[Question]) -> Tensor:
        with torch.set_grad_enabled(gradient):
            own = own.detach().requires_grad_(gradient)
            scores: Tensor = module(own, assemble(questions)).scores
            if gradient:
                torch.autograd.grad(scores.sum(), own)
        return scores.detach()

    several = len(inputs) > 1
    questions = [Question(program, number if several else 0) for number, program in enumerate(programs)]

    def together() -> Tensor:
        return run(inputs, questions)

    def one_at_a_time() -> Tensor:
        return torch.cat(
            [run(inputs[k if several else 0 :][:1], [Question(program)]) for k, program in enumerate(programs)]
        )

    both, difference = (together(), one_at_a_time()), 0.0
    difference = float((both[0] - both[1]).abs().max())
    took = [(_seconds(together), _seconds(one_at_a_time)) for _ in range(repeats)]
    return {
        "case": case,
        "seconds": {"batch": min(batch[0] for batch, _ in took), "one at a time": min(one[0] for _, one in took)},
        "ratio": median(one[0] / batch[0] for batch, one in took),
        "processor_ratio": median(one[1] / batch[1] for batch, one in took),
        "largest_difference": difference,
        "largest_score": float(both[1].abs().max()),
    }


def _seconds(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds of a run by the clock and by the processor."""
    clock, processor = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - clock, time.process_time() - processor


if __name__ == "__main__":
    main()
