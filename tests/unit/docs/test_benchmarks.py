"""The benchmarks' page says what the committed results say."""

from benchmarks.page import PAGE, page


def test_the_page_is_written_from_the_results() -> None:
    assert PAGE.read_text("utf-8") == page(), "write it again with: python -m benchmarks.page"
