"""The commands `analyse` and `rerender`."""

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from scene_attack.analysis.images import save_png
from scene_attack.analysis.records import AnalysisRequest, Rerendering
from scene_attack.errors import InvalidRequest
from scene_attack.runs.analyse import NO_ADVERSARY, StoredAnalysis, analyse_stored
from scene_attack.runs.execute import execute
from scene_attack.runs.prepare import prepare
from scene_attack.runs.result import PERTURBATION
from tests.unit.client.command_line import cli
from tests.unit.jobs.small import LIBRARY, SPHERE, spec

pytestmark = pytest.mark.slow


def test_analyse_prints_what_was_asked_for_and_keeps_it(tmp_path: Path) -> None:
    execute(spec({"renderer": "torch", "groups": ["illumination", "material"], "steps": 1}), tmp_path, LIBRARY)
    done = cli("analyse", str(tmp_path), "--minimal", "--survival")
    assert done.returncode == 0, done.stderr
    for words in ("Subsets of the groups", "Shapley values of the groups, exact", "Minimal change", "largest texel"):
        assert words in done.stdout
    assert "minimal" in done.stderr  # progress
    assert NO_ADVERSARY.text in done.stderr  # one step fools nobody
    kept = StoredAnalysis.model_validate_json((tmp_path / "analyses.json").read_text())
    assert kept.analyses.minimal is not None
    assert kept.analyses.coordinates is None
    assert kept.analyses.survival is None
    save_file(load_file(tmp_path / PERTURBATION) | {"illumination": torch.zeros(2, 3)}, tmp_path / PERTURBATION)
    with pytest.raises(InvalidRequest, match=r"directory: .*'illumination': \[2, 3\]"):
        analyse_stored(tmp_path, AnalysisRequest(), LIBRARY, lambda *_: None)
    (tmp_path / "result.json").write_text('{"spec": null}')
    with pytest.raises(InvalidRequest, match=r"result\.json is no result: spec: .* \(and \d+ more\)$") as refused:
        analyse_stored(tmp_path, AnalysisRequest(), LIBRARY, lambda *_: None)
    assert "http" not in str(refused.value)


def test_rerender_answers_for_an_image_and_writes_the_rendering(tmp_path: Path) -> None:
    save_png(prepare(spec({"renderer": "torch"}), LIBRARY).original.saved, tmp_path / "image.png")
    (tmp_path / "spec.json").write_text(json.dumps({"scene": SPHERE}))
    arguments = ["rerender", str(tmp_path / "image.png"), str(tmp_path / "spec.json"), "--steps", "1"]
    done = cli(*arguments, "--out", str(tmp_path / "again.png"), "--json")
    assert done.returncode == 0, done.stderr
    assert len(Rerendering.model_validate_json(done.stdout).losses) == 2
    assert (tmp_path / "again.png").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["analyse", "{here}"], "directory"),
        (["rerender", "{here}/no.png", "{here}/spec.json"], "IMAGE"),
        (["rerender", "{here}/spec.json", "{here}/spec.json"], "IMAGE"),
        (["rerender", "{here}/no.png", "{here}/spec.json", "--optimiser", "lbfgs"], "--optimiser"),
    ],
)
def test_bad_input_is_named_and_exits_2(arguments: list[str], said: str, tmp_path: Path) -> None:
    (tmp_path / "spec.json").write_text(json.dumps({"scene": SPHERE}))
    done = cli(*(argument.format(here=tmp_path) for argument in arguments))
    assert done.returncode == 2, done.stderr
    assert f"bad input: {said}" in done.stderr
    assert "Traceback" not in done.stderr
