import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.library import Library
from scene_attack_questions.iep.checkpoint import load
from tests.unit.training.iep.small import RECIPE, After, never, silent, stages
from training.iep.export import check, write
from training.iep.stages import Stages

pytestmark = [pytest.mark.usefixtures("one_thread"), pytest.mark.slow]


def test_a_training_that_ends_early_again_and_again_ends_in_the_same_bits(
    whole: Stages, copied: Path, library: Library
) -> None:
    for made in [*copied.glob("*.checkpoint"), *copied.glob("features/*"), *copied.glob("data/validation*")]:
        made.unlink()
    runs = 0
    resumed = stages(copied, library, over=After(2))
    while not resumed.run():
        resumed = stages(copied, library, over=After(2))
        runs += 1
    assert runs >= 5
    for name in ("network", "generator"):
        one, other = (getattr(made, name).state_dict() for made in (whole, resumed))
        assert all(torch.equal(one[key], other[key]) for key in one)
    for split in ("train", "validation", "test"):
        assert resumed.data.digest(split) == whole.data.digest(split)


def test_training_changes_every_part(whole: Stages, library: Library, tmp_path: Path) -> None:
    fresh = stages(tmp_path, library)
    for name in ("network", "generator"):
        one, other = (getattr(made, name).state_dict() for made in (whole, fresh))
        assert sum(not torch.equal(one[key], other[key]) for key in one) > 0.8 * len(one)


@pytest.mark.parametrize("part", ["trunk", "engine", "generator"])
def test_a_damaged_checkpoint_is_refused_in_a_line(copied: Path, library: Library, part: str) -> None:
    path = copied / f"{part}.checkpoint"
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InvalidRequest, match=r"checkpoint is damaged \(") as refused:
        stages(copied, library).run()
    assert "\n" not in str(refused.value)


def test_damaged_data_and_data_of_another_recipe_are_refused(copied: Path, library: Library) -> None:
    with pytest.raises(InvalidRequest, match="move it away"):
        stages(copied, library, replace(RECIPE, questions=5)).run()
    made = stages(copied, library)
    piece = made.data.pieces("test")[0]
    path = made.data.path(piece)
    data = bytearray(path.read_bytes())
    data[-1000] ^= 1
    path.write_bytes(data)
    with pytest.raises(InvalidRequest, match="damaged"):
        made.data.read(piece)
    path.write_bytes(data[:100])
    with pytest.raises(InvalidRequest, match="damaged"):
        made.data.read(piece)


def test_a_finished_training_is_written_and_its_figures_are_found_again(
    whole: Stages, folder: Path, library: Library, tmp_path: Path
) -> None:
    written = write(whole, tmp_path, "python -m training iep", silent)
    checkpoint = load(written.weights)
    rounded = whole.network.engine.mapping.second - checkpoint.network.engine.mapping.second
    assert 0 < float(rounded.abs().max()) <= 0.5001 / 127 * float(whole.network.engine.mapping.second.abs().max())
    assert torch.equal(whole.network.trunk.layers[0][0].weight, checkpoint.network.trunk.layers[0][0].weight)
    for text in (written.summary, written.card.read_text()):
        assert "| overall | " in text
    assert "| test | 2 |" in written.data_card.read_text()
    found = check(written.weights, folder, library, silent, never)
    assert found is not None
    assert (found.summary, found.disagreements) == (written.summary, [])
    facts = json.loads(written.facts.read_text())
    facts["check"]["programs"]["wilson"] = [0.5, 1.0]
    written.facts.write_text(json.dumps(facts))
    again = check(written.weights, folder, library, silent, never)
    assert again is not None
    assert again.disagreements == ["programs is 0.0000, not within 0.5000 and 1.0000"]
    written.weights.write_bytes(written.weights.read_bytes()[:-1])
    with pytest.raises(InvalidRequest, match="damaged or not the file"):
        check(written.weights, folder, library, silent, never)
    written.facts.unlink()
    with pytest.raises(InvalidRequest, match=r"\.json is not there, which has the figures"):
        check(written.weights, folder, library, silent, never)
    missing = tmp_path / "none" / written.weights.name
    with pytest.raises(InvalidRequest, match=r"there is no file .*; .*train them: python -m training iep"):
        check(missing, tmp_path / "none" / "iep", library, silent, never)
    with pytest.raises(InvalidRequest, match=f"of a training of yours: --weights {written.weights}"):
        check(missing, written.weights.parent / "iep", library, silent, never)
