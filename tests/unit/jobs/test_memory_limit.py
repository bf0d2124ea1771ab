"""Processes that render share the machine's memory: all limits, those of reading too, add up to less than it."""

from pathlib import Path

import pytest

from scene_attack.scenes.reading.isolated import READING_BYTES
from scene_attack_service.jobs import processes as module
from scene_attack_service.jobs.processes import LEAST_MEMORY, MOST_MEMORY, REST_BYTES, machine_memory, memory_limit
from scene_attack_service.settings import Settings

GIB = 2**30


@pytest.mark.parametrize("machine", [24, 32, 64])
@pytest.mark.parametrize("workers", [1, 2, 4])
def test_the_limits_add_up_to_less_than_the_machine(monkeypatch, machine, workers):
    monkeypatch.setattr(module, "machine_memory", lambda: machine * GIB)
    limit = memory_limit(Settings(workers=workers))
    total = (workers + 2) * limit + READING_BYTES + REST_BYTES
    assert total <= machine * GIB or limit == LEAST_MEMORY
    assert LEAST_MEMORY <= limit <= MOST_MEMORY


def test_a_large_machine_has_the_largest_default(monkeypatch):
    monkeypatch.setattr(module, "machine_memory", lambda: 1_000 * GIB)
    assert memory_limit(Settings()) == MOST_MEMORY
    assert memory_limit(Settings(job_memory_bytes=5 * GIB)) == 5 * GIB


def test_a_containers_limit_counts_if_it_is_less_than_the_machine(tmp_path: Path):
    limit = tmp_path / "memory.max"
    physical = machine_memory(limit)
    limit.write_text("max\n")
    assert machine_memory(limit) == physical
    limit.write_text(f"{GIB}\n")
    assert machine_memory(limit) == GIB
    limit.write_text(f"{2**60}\n")
    assert machine_memory(limit) == physical
