import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

from scene_attack.analysis.images import load_png, save_png
from scene_attack.analysis.verdict import held_within
from scene_attack.attacks.run import AttackRun, run_attack
from scene_attack.errors import Cancelled
from scene_attack.rendering.factory import build
from scene_attack.rendering.pyrender import planner
from scene_attack.runs.execute import Progress, execute
from scene_attack.runs.prepare import prepare
from scene_attack.runs.replay import replay
from scene_attack.runs.result import AtEpsilon, Result, outcome
from scene_attack.runs.spec import parse
from scene_attack.scenes.resolve import resolve
from tests.unit.jobs.small import LIBRARY, spec

pytestmark = pytest.mark.slow

ATTACKS: list[dict[str, Any]] = [
    {"renderer": "image"},
    {"renderer": "torch"},
    {"renderer": "pyrender", "delta": 1e-2, "steps": 2},
    {"renderer": "pyrender", "method": "fgsm", "groups": ["rotation", "camera"], "steps": 2},
    {
        "renderer": "torch",
        "groups": ["normals"],
        "expectation": {"intensity": 0.3, "sensor": {"defocus": 0.5}, "samples": 2, "checks": 6},
    },
]


REPLAY = """
import json, sys
from pathlib import Path
from scene_attack.runs.set_up import set_up
from scene_attack.runs.replay import replay
from scene_attack_service.settings import Settings
set_up(Settings())
from tests.unit.jobs.small import LIBRARY
print(json.dumps([replay(Path(folder), LIBRARY).model_dump(mode="json") for folder in sys.argv[1:]]))
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Path, Result, dict[str, Any]]]:
    """For each of ATTACKS its folder, its result, and what another process says that replays them all."""
    folders = [tmp_path_factory.mktemp("attack") / "one" for _ in ATTACKS]
    results = [execute(spec(attack), folder, LIBRARY) for attack, folder in zip(ATTACKS, folders, strict=True)]
    command = [sys.executable, "-c", REPLAY, *map(str, folders)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return list(zip(folders, results, json.loads(done.stdout), strict=True))


@pytest.mark.parametrize("number", range(len(ATTACKS)), ids=lambda number: " ".join(map(str, ATTACKS[number].values())))
def test_twice_the_same_bytes_and_again_in_another_process(
    number: int, runs: list[tuple[Path, Result, dict[str, Any]]], tmp_path: Path
) -> None:
    folder, result, again = runs[number]
    assert execute(spec(ATTACKS[number]), tmp_path, LIBRARY).attacked == result.attacked
    for name in ("perturbation.safetensors", "original.png", "attacked.png", "perturbation.png"):
        assert (folder / name).read_bytes() == (tmp_path / name).read_bytes(), name
    assert again["pixels_differing"] == 0
    assert again["same_backend"]
    assert again["replayed"] == result.attacked.model_dump(mode="json")


def _edit(folder: Path, part: str, field: str, value: object) -> None:
    result = json.loads((folder / "result.json").read_text())
    result[part][field] = value
    (folder / "result.json").write_text(json.dumps(result))


def _one_pixel(image: Path) -> None:
    pixels = load_png(image)
    pixels[20, 20] = 255 - pixels[20, 20]
    save_png(pixels, image)


@pytest.mark.parametrize(
    ("differs", "alter"),
    [
        ("original.png", lambda folder: _one_pixel(folder / "original.png")),
        ("attacked.png", lambda folder: _one_pixel(folder / "attacked.png")),
        ("original", lambda folder: _edit(folder, "original", "confidence", 0.5)),
        ("attacked", lambda folder: _edit(folder, "attacked", "confidence", 0.5)),
        ("change.perceptibility", lambda folder: _edit(folder, "change", "perceptibility", 0.001)),
        ("verdict.verified", lambda folder: _edit(folder, "verdict", "verified", False)),
    ],
)
def test_replaying_names_what_was_altered(
    differs: str,
    alter: Callable[[Path], None],
    runs: list[tuple[Path, Result, dict[str, Any]]],
    tmp_path: Path,
) -> None:
    folder, result, again = runs[0]
    assert (again["differs"], again["reproduced"]) == ([], True)
    assert result.verdict.verified
    copy = shutil.copytree(folder, tmp_path / "copy")
    alter(copy)
    altered = replay(copy, LIBRARY)
    assert (altered.differs, altered.reproduced) == ((differs,), False)


def test_the_files_say_what_the_result_says(tmp_path: Path) -> None:
    result = execute(spec({"renderer": "torch"}), tmp_path, LIBRARY)
    assert Result.model_validate_json((tmp_path / "result.json").read_text()) == result
    assert json.loads((tmp_path / "trace.json").read_text()) == [row.model_dump() for row in result.trace]
    perturbation = load_file(tmp_path / "perturbation.safetensors")
    assert {g: v.dtype for g, v in perturbation.items()} == dict.fromkeys(
        ("normals", "illumination", "material"), torch.float32
    )
    change = load_png(tmp_path / "attacked.png").double() - load_png(tmp_path / "original.png").double()
    p = float((change / 255).square().sum(-1).mean().sqrt())
    assert result.change.perceptibility == pytest.approx(p, rel=1e-12)
    assert result.spec == parse(result.spec).model_dump(mode="json")  # the echoed spec is a spec, and complete
    provenance = result.provenance
    assert "torch" in provenance.backend
    assert provenance.seed == 0
    assert len(provenance.scene_sha256) == len(provenance.weights_sha256) == 64


def test_the_ends_of_the_subset_table_are_the_images_rendered_afresh(tmp_path: Path) -> None:
    result = execute(spec({"renderer": "torch"}), tmp_path, LIBRARY)
    prepared = prepare(spec({"renderer": "torch"}), LIBRARY)
    perturbation = load_file(tmp_path / "perturbation.safetensors")
    assert torch.equal(prepared.verifier.image({}), load_png(tmp_path / "original.png"))
    assert torch.equal(prepared.verifier.image(perturbation), load_png(tmp_path / "attacked.png"))
    assert len(result.subsets) == 8
    empty, full = result.subsets[0], result.subsets[-1]
    assert (empty.label, empty.goal_probability) == (result.original.label, result.original.goal_probability)
    assert (full.label, full.goal_probability) == (result.attacked.label, result.attacked.goal_probability)
    assert (empty.perceptibility, full.perceptibility) == (0.0, result.change.perceptibility)


def test_the_error_of_images_that_opengl_drew_too_is_in_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every image is drawn twice here, so that the largest of all errors is at least that of the stored image."""
    monkeypatch.setattr(planner, "EVERY", 1)
    attack = {"renderer": "pyrender", "delta": 1e-2, "steps": 2}
    result = execute(spec(attack), tmp_path / "rasterised", LIBRARY)
    exact = execute(spec(attack, tolerance="exact"), tmp_path / "exact", LIBRARY)
    assert result.measured.sampled_error is not None
    assert 0 < result.measured.sampled_error.mean <= 1e-3
    assert 0 <= result.measured.sampled_error.share <= 1e-2
    assert exact.measured.sampled_error is None
    again = Result.model_validate_json((tmp_path / "rasterised" / "result.json").read_text())
    assert again.measured.sampled_error == result.measured.sampled_error


def test_a_search_that_held_at_its_epsilon_says_so(tmp_path: Path) -> None:
    """APGD's first step moves each value to ε, within which the network holds: p is √3 · ε."""
    limits = {"epsilon": {"image": 0.01}, "constraint": "backtrack", "perceptibility": 0.05}
    result = execute(spec({"renderer": "image", "method": "apgd", "steps": 1} | limits), tmp_path, LIBRARY)
    assert result.change.at_epsilon == {"image": AtEpsilon(coordinates=64 * 64 * 3, share=1.0)}
    line = outcome(result)
    assert (line["outcome"], line["epsilon_bound"], line["perceptibility_limit"]) == ("held", True, 0.05)
    assert held_within(line) == "within ε, p used 17.32 of 50.00 ×10⁻³"
    free = execute(spec({"renderer": "image", "method": "fgsm", "steps": 1}), tmp_path / "free", LIBRARY)
    assert free.change.at_epsilon == {}
    assert not held_within(outcome(free))


@pytest.mark.parametrize(("drawn_by", "credited"), [("pyrender", False), ("torch", True)])
def test_a_map_is_credited_where_it_is_shown(drawn_by: str, credited: bool, tmp_path: Path) -> None:
    attack = {"renderer": "image", "base_renderer": drawn_by, "steps": 1}
    shown = execute(spec(attack=attack), tmp_path, LIBRARY).provenance.credits
    assert any("studio" in credit for credit in shown) == credited


def test_progress_tells_every_step_in_order(tmp_path: Path) -> None:
    seen: list[Progress] = []
    result = execute(spec({"renderer": "image"}), tmp_path, LIBRARY, progress=seen.append)
    assert [p.phase for p in seen] == ["loading"] + ["attacking"] * len(result.trace) + ["analysing"]
    assert [p.row for p in seen[1:-1]] == result.trace


def test_cancelled_before_the_next_rendering(tmp_path: Path) -> None:
    steps: list[int] = []
    with pytest.raises(Cancelled):
        execute(
            spec({"renderer": "image", "steps": 100, "learning_rate": {"image": 0}}),
            tmp_path / "out",
            LIBRARY,
            progress=lambda p: steps.append(p.step),
            cancelled=lambda: bool(steps) and steps[-1] >= 2,
        )
    assert steps[-1] == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("last", ["attacking", "analysing"])
def test_an_interrupted_job_ends_in_the_same_result(last: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scene_attack.attacks.run.CHECKPOINT_SECONDS", -1.0)
    rates = {"normals": 1e-5, "illumination": 1e-5}  # not in the order of their names
    job = spec({"renderer": "torch", "steps": 4, "learning_rate": rates, "groups": list(rates)})
    whole = execute(job, tmp_path / "whole", LIBRARY)
    seen: list[Progress] = []
    saved = tmp_path / "checkpoint"
    with pytest.raises(Cancelled):
        execute(
            job,
            tmp_path / "half",
            LIBRARY,
            progress=seen.append,
            cancelled=lambda: bool(seen) and seen[-1].phase == last and seen[-1].step >= 2,
            checkpoint=saved,
        )
    assert saved.exists()
    resumed = execute(job, tmp_path / "resumed", LIBRARY, checkpoint=saved)
    assert (tmp_path / "whole/perturbation.safetensors").read_bytes() == (
        tmp_path / "resumed/perturbation.safetensors"
    ).read_bytes()
    assert _timeless(resumed) == _timeless(whole)


def _timeless(result: Result) -> list[tuple[str, Any]]:
    """Everything that a result says, in its order, but the times."""
    trace = [row.model_copy(update={"seconds": 0.0}) for row in result.trace]
    cost = result.cost.model_copy(update={"seconds": 0.0})
    return list(result.model_copy(update={"cost": cost, "trace": trace}).model_dump().items())


def test_a_targeted_goal_is_followed(tmp_path: Path) -> None:
    result = execute(spec({"renderer": "image", "steps": 2}, goal={"reach": "soccer ball"}), tmp_path, LIBRARY)
    assert result.verdict.leave is None
    assert result.verdict.reach == "soccer ball"
    assert result.trace[-1].loss < result.trace[0].loss
    assert result.attacked.goal_probability > result.original.goal_probability


def test_a_spec_written_in_another_order_is_the_same_request() -> None:
    assert spec({"groups": ["material", "normals"]}) == spec({"groups": ["normals", "material"]})


def test_the_image_error_is_that_of_the_attack_s_image_of_the_stored_perturbation(tmp_path: Path) -> None:
    """Rendered again from the files, by a new renderer of the job's tolerance and by its exact twin."""
    asked = spec({"renderer": "torch", "groups": ["normals"]}, tolerance=2e-2)
    result = execute(asked, tmp_path, LIBRARY)
    renderer = build(resolve(asked.scene, LIBRARY), "torch", groups=("normals",), tolerance=2e-2)
    moved = renderer.initial()["normals"] + load_file(tmp_path / "perturbation.safetensors")["normals"]
    image, exact = (one.render({"normals": moved[None].double()}).double() for one in (renderer, renderer.exact()))
    wanted = float((image - exact).abs().max())
    assert 1e-5 < wanted < 2e-2
    assert result.measured.image_error == pytest.approx(wanted, rel=1e-3)


def test_the_verdict_is_of_the_images_rendered_afresh_whatever_the_loop_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop here claims a verified adversary at its second step, with the scores of another label.

    The perturbation that it hands over changes nothing. Its counts differ from those of the last row of its trace.
    """
    attack = {"renderer": "torch", "groups": ["normals"], "truncation": 1, "learning_rate": {"normals": 1e-4}}
    truth = execute(spec(attack), tmp_path / "first", LIBRARY).original.label
    claimed: list[AttackRun] = []

    def claims(run: AttackRun) -> AttackRun:
        best = run_attack(run).best
        assert best is not None
        run.best = replace(best, step=1, delta=torch.zeros_like(best.delta), scores=best.scores.roll(1))
        run.fooled = run.verified = True
        run.ever_truncated[:3, :2] = True
        claimed.append(run)
        return run

    monkeypatch.setattr("scene_attack.runs.execute.run_attack", claims)
    result = execute(spec(attack, goal={"truth": truth}), tmp_path / "right", LIBRARY)
    found = claimed[-1]
    assert found.step == 3
    assert int(found.ever_truncated.sum()) > found.trace[-1].truncated
    assert (result.outcome, result.verified, result.verdict.right_before) == ("held", False, True)
    assert result.verdict.fooled  # what the loop believed stands beside the verdict
    assert result.in_loop.label != result.attacked.label == truth
    assert (result.change.step, result.cost.steps) == (1, 3)
    assert result.cost.truncated == int(found.ever_truncated.sum())
    assert (result.change.perceptibility, result.change.float_perceptibility) == (0.0, 0.0)
    unknown = execute(spec(attack), tmp_path / "unknown", LIBRARY)
    assert (unknown.outcome, unknown.in_loop.label) == ("held", result.in_loop.label)
    wrong = execute(spec(attack, goal={"truth": result.in_loop.label}), tmp_path / "wrong", LIBRARY)
    assert (wrong.outcome, wrong.verdict.right_before) == ("still-wrong", False)


def test_pixels_beyond_the_limit_are_counted_in_the_saved_images(tmp_path: Path) -> None:
    result = execute(spec({"renderer": "torch", "groups": ["normals"], "truncation": 2}), tmp_path, LIBRARY)
    original, attacked = (load_png(tmp_path / f"{name}.png").int() for name in ("original", "attacked"))
    counts = [int(((attacked - original).abs() > limit).any(-1).sum()) for limit in (1, 2, 3)]
    assert result.change.beyond_truncation == counts[1]
    assert len(set(counts)) == 3  # so that another limit would be noticed
