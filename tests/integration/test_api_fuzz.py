"""Generated requests against the running API. `python -m benchmarks.api_fuzz` sends more of them."""

from pathlib import Path

import pytest

from benchmarks.api_fuzz import fuzz, served

pytestmark = pytest.mark.integration

EXAMPLES = 12


def test_answers_to_generated_requests_are_as_the_api_describes_them(tmp_path: Path) -> None:
    with served(tmp_path) as server:
        done = fuzz(server, EXAMPLES, seed=1)
        assert done.returncode == 0, done.stdout
        assert "No issues found" in done.stdout
        assert server.mistakes() == []
