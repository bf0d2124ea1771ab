"""The table of networks that know one look: each row is of its own training and setting."""

from pathlib import Path

from benchmarks.study.one_look import light_and_material
from benchmarks.study.record import Job
from tests.unit.docs.study.test_study_records import job, rows_of, with_jobs


def view(attack: str, target: str, name: str, **others: object) -> Job:
    return job(0.02, f"{attack}{target}{name}", attack=attack, target=target, mesh=name, **others)


def test_each_training_has_its_rows_and_the_paper_its_own(tmp_path: Path) -> None:
    """One look falls to light twice of two, a stronger step of material has one success in two, and many looks hold;
    normals, and a network without a counterpart of one look, are left out.
    """
    held = {"outcome": "held", "verified": False, "after": "x", "truncated": 7}
    one, many = "alexnet-one-look", "alexnet-furniture"
    jobs = [
        view("illumination", one, "a", truncated=3),
        view("illumination", one, "b", truncated=5),
        view("material, ×3", one, "a", **held | {"fooled": True, "p_loop": 0.03}),
        view("material, ×3", one, "b", truncated=1),
        view("illumination", many, "a", **held),
        view("normals", many, "a"),
        view("illumination", "resnet34-furniture", "a"),
    ]
    first, second = ([job.model_dump(mode="json") for job in own] for own in (jobs[:4], jobs[4:]))
    (tmp_path / "second").mkdir()
    records = [
        with_jobs("differentiable", first, tmp_path),
        with_jobs("differentiable", second, tmp_path / "second"),
    ]
    rows = rows_of(light_and_material(records))
    assert rows[0] == ["**AlexNet**", "paper", "233", "29.6 · 25.8", "", "", "–", "18.9 · 25.8", "", "", "–"]
    assert rows[1][1:3] == ["one look", "2"]
    assert rows[1][4:] == ["**100.0 · 20.0**", "34.2–100.0", "4.0", "", "", "", ""]
    assert rows[2][1:3] == ["one look, ×3", "2"]
    assert rows[2][3:] == ["", "", "", "", "50.0 · 30.0", "**50.0 · 20.0**", "9.5–90.5", "4.0"]
    assert rows[3][:3] == ["", "varied looks", "1"]
    assert rows[3][4:7] == ["**0.0 · –**", "0.0–79.3", "7.0"]
    assert len(rows) == 4
