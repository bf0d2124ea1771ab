"""The page of the networks, on the real app."""

from httpx import Client

from scene_attack.targets.info import available
from tests.unit.api.dashboard_records import Tags


def test_each_network_has_a_card_with_what_is_known_of_it(client: Client, finished: str) -> None:  # noqa: ARG001
    page = Tags(client.get("/targets").text)
    for target in available():
        assert target.title in page.text
        assert f"{target.input_size[0]} × {target.input_size[1]} pixels" in page.text
    assert "1,000 of ImageNet-1k" in page.text
    # Wilson's interval of the jobs of this record that fooled, each on a scene that the network had right
    assert "100.0 %" in page.text
    assert "not known" in page.text  # of networks without a job
    assert [a["href"] for a in page.all("a") if "aria-current" in a] == ["/targets"]
