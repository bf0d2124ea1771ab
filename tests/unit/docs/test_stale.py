"""Which results are older than the code: every committed one is known, and changed images or files are noticed."""

import json
import subprocess
from pathlib import Path

import pytest

from benchmarks import stale
from benchmarks.stale import ALEXNET, DEPENDS, IEP, LITE0, RESNET, ROOT, SCENES, network_print, renderer_print
from scene_attack.rendering import color
from scene_attack.scenes.library import Library
from scene_attack_service.settings import Settings

TODAY = {"torch": "1", "pyrender llvmpipe": "2", "iep": "3", "efficientnet-lite0": "4"}


@pytest.fixture
def result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A signed result that depends on pyrender and a network."""
    monkeypatch.setattr(stale, "ROOT", tmp_path)
    monkeypatch.setattr(stale, "SIGNED", tmp_path / "signed.json")
    monkeypatch.setitem(DEPENDS, "a.json", ("pyrender", "iep"))
    (tmp_path / "a.json").write_text("{}")
    stale.sign(["a.json"], TODAY)
    return tmp_path / "a.json"


def test_every_committed_result_says_on_what_it_depends() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "docs", "benchmarks"], cwd=ROOT, capture_output=True, check=True, text=True
    )
    inputs = {"benchmarks/views.json", "benchmarks/study/paper.json", "benchmarks/results/fingerprints.json"}
    assert {name for name in listed.stdout.splitlines() if name.endswith(".json")} - inputs == set(DEPENDS)


def test_a_signed_result_is_up_to_date(result: Path) -> None:
    assert json.loads((result.parent / "signed.json").read_text())["a.json"]["made by"].keys() == {
        "pyrender llvmpipe",
        "iep",
    }
    assert stale.stale("a.json", TODAY) is None
    assert stale.stale("a.json", TODAY | {"torch": "other"}) is None  # it does not depend on it


@pytest.mark.usefixtures("result")
def test_other_images_or_scores_make_it_stale() -> None:
    assert stale.stale("a.json", TODAY | {"pyrender llvmpipe": "5", "iep": "6"}) == "changed since: pyrender, iep"
    monday = {key: value for key, value in TODAY.items() if "pyrender" not in key} | {"pyrender other driver": "2"}
    assert "cannot be told here" in str(stale.stale("a.json", monday))


def test_a_result_that_was_written_again_is_stale(result: Path) -> None:
    result.write_text('{"figure": 2}')
    assert stale.stale("a.json", TODAY) == "it was written again after it was signed"


@pytest.mark.parametrize("renderer", ["torch", "pyrender"])
def test_a_renderer_that_draws_otherwise_has_another_fingerprint(
    renderer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = Library(Settings().cache_dir, tmp_path)
    before = renderer_print(renderer, library, SCENES[:1])
    assert renderer_print(renderer, library, SCENES[:1]) == before
    original = color.quantize
    monkeypatch.setattr(color, "quantize", lambda images: original(images + 1 / 255))
    assert renderer_print(renderer, library, SCENES[:1]) != before


@pytest.mark.slow
def test_every_shipped_network_has_a_fingerprint_of_its_own() -> None:
    prints = [network_print(name) for name in (LITE0, ALEXNET, RESNET, IEP)]
    assert len(set(prints)) == len(prints)
