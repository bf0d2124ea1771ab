from pathlib import Path

from scene_attack_service.jobs.files import WorkingFiles
from scene_attack_service.jobs.leases import Attempt
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.records import add, start


def test_sweeping_removes_what_is_over_and_keeps_what_is_not(record: Record, tmp_path: Path) -> None:
    working_files = WorkingFiles(tmp_path)
    running, queued, over = add(record), add(record), add(record)
    record.leases.lose(start(record, running))
    start(record, running)
    record.leases.fail(start(record, over), "internal", "because")
    for job in (running, queued, over):
        with working_files.checkpoint(Attempt(job.id, 1)) as path:
            path.write_bytes(b"saved")
    kept = tmp_path / "running" / f"{running.id}-2"
    for out in (kept, kept.with_name(f"{running.id}-1"), kept.with_name(f"{over.id}-1")):
        out.mkdir(parents=True)
    path.with_suffix(".0123.part").write_bytes(b"half")

    working_files.sweep(record)

    assert {file.name for file in (tmp_path / "checkpoints").iterdir()} == {running.id, queued.id}
    assert list((tmp_path / "running").iterdir()) == [kept]
