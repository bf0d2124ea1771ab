"""A process that gives way has the niceness of job processes, and so has its session where sessions have one."""

import re
import subprocess
import sys

import pytest

from services.jobs.processes import AUTOGROUP, NICENESS

pytestmark = pytest.mark.slow

SCRIPT = f"""
import os
from services.jobs.processes import give_way
give_way()
print(os.nice(0))
print(open({str(AUTOGROUP)!r}).read() if os.path.exists({str(AUTOGROUP)!r}) else "")
"""


def test_a_process_that_gives_way_is_nice_and_so_is_its_session() -> None:
    command = [sys.executable, "-c", SCRIPT]
    before = int(subprocess.run(["nice"], capture_output=True, check=True, text=True).stdout)
    said = subprocess.run(command, start_new_session=True, capture_output=True, check=True, text=True).stdout
    own, _, session = said.partition("\n")
    assert int(own) == min(19, before + NICENESS)
    if session.strip():
        found = re.search(r"nice (-?\d+)", session)
        assert found is not None
        assert int(found[1]) == NICENESS
