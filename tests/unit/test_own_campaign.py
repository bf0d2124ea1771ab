"""A campaign as objects: what it comes to, that it goes on where it was, and what is said of one that cannot run."""

import sys
from pathlib import Path
from typing import Any

import pytest
import torch

import scene_attack as sa
from scene_attack.extras import MissingExtra
from scene_attack.runs import campaign_run
from scene_attack.targets.info import TARGETS

pytestmark = pytest.mark.slow


def network(name: str, seed: int) -> sa.Target:
    layer = torch.nn.Linear(192, 3)
    with torch.no_grad():
        layer.weight.copy_(torch.randn(3, 192, generator=torch.Generator().manual_seed(seed)))
    module = torch.nn.Sequential(torch.nn.Flatten(), layer)
    return sa.target(module, labels=["a", "b", "c"], preprocessing={"input_size": [8, 8]}, name=name)


def study(*names: str, **more: Any) -> sa.Campaign:
    scenes = [
        sa.Scene(camera=sa.Camera(size=(32, 32), azimuth=k), objects=[{"mesh": "primitive/cube"}]) for k in (0, 1)
    ]
    columns = [{"name": "image", "attack": sa.FGSM(renderer="image", steps=2)}]
    selection = {"right": False}
    return sa.Campaign(grids=[sa.Grid(scenes=scenes, targets=names, attacks=columns, selection=selection, **more)])


def test_it_has_a_table_a_frame_and_results_and_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    targets = [network("first", 0), network("second", 1)]
    phases: list[str] = []
    run = sa.campaign(
        study("first", "second"), tmp_path, targets=targets, progress=lambda now: phases.append(now.phase)
    )
    assert phases == ["selecting"] * 4 + ["attacking"] * 5
    assert [(cell.target, cell.ended, cell.failed) for cell in run.table.cells] == [("first", 2, 0), ("second", 2, 0)]
    frame = run.to_frame()
    assert sorted(frame["target"]) == ["first", "first", "second", "second"]
    assert list(frame["attacked"]) == [result.attacked.label for result in run.results]
    assert not {"first", "second"} & TARGETS.keys()

    def no_attack(*_: Any, **__: Any) -> None:
        raise AssertionError("nothing is left to do")

    monkeypatch.setattr(campaign_run, "execute", no_attack)
    again = sa.campaign(study("first", "second"), tmp_path, targets=targets)
    assert again.record == run.record


def test_one_that_cannot_run_is_refused_by_its_field(tmp_path: Path) -> None:
    with pytest.raises(sa.InvalidRequest, match="there is no target 'nobody'") as refused:
        sa.campaign(study("nobody"), tmp_path)
    assert refused.value.field == "grids.0.targets.0.name"
    with pytest.raises(sa.InvalidRequest, match=r"must be an object such as sa\.Scene, .*, not list"):
        sa.campaign([], tmp_path)  # type: ignore[arg-type]
    with pytest.raises(sa.InvalidRequest, match="has no label 'dog'") as refused:
        sa.campaign(study("first", goal={"truth": "dog"}), tmp_path, targets=[network("first", 0)])
    assert refused.value.field == "grids.0.goal.truth"


def test_without_pandas_a_frame_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = sa.campaign(study("first"), tmp_path, targets=[network("first", 0)])
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(
        MissingExtra, match=r'a DataFrame needs the extra "pandas": pip install "scene-attack\[pandas\]"'
    ):
        run.to_frame()
