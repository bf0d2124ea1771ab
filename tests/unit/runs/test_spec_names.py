import pytest

from scene_attack.runs.spec import asked_of, attack_name, group_words, job_name

TORCH = ("normals", "illumination", "material")
PAPERS = ["illumination", "color", "translation", "rotation"]


@pytest.mark.parametrize(
    ("attack", "name"),
    [
        ({"renderer": "image", "groups": ["image"], "method": "fgsm"}, "image fgsm"),
        ({"renderer": "torch", "groups": TORCH[::-1], "method": "fgsm"}, "torch combined fgsm"),
        ({"renderer": "torch", "groups": ["normals", "material"], "method": "zoo"}, "torch normals+material zoo"),
        ({"renderer": "pyrender", "groups": ["color"], "method": "zoo"}, "pyrender color zoo"),
        ({"renderer": "pyrender", "groups": PAPERS, "method": "zoo"}, "pyrender combined zoo"),
        ({"renderer": "pyrender", "groups": ["rotation", "camera"], "method": "zoo"}, "pyrender rotation+camera zoo"),
        ({"renderer": "not-installed", "groups": ["fog"], "method": "hill"}, "not-installed fog hill"),
    ],
)
def test_an_attack_has_a_name(attack: dict[str, object], name: str) -> None:
    assert attack_name({"attack": attack}) == name
    assert attack_name({"attack": attack, "goal": {"reach": "teapot"}}) == f"{name} targeted"


def test_a_group_is_worded_by_its_renderer() -> None:
    assert group_words({"attack": {"renderer": "torch"}}, "normals") == "surface normals"
    assert group_words({"attack": {"renderer": "pyrender"}}, "color") == "colour"
    assert group_words({"attack": {"renderer": "not-installed"}}, "fog") == "fog"


@pytest.mark.questions
def test_a_job_is_named_by_its_questions() -> None:
    scene = {"objects": [{"mesh": "primitive/cube"}, {"mesh": "furniture/couch"}]}
    counting = [{"function": "scene"}, {"function": "count", "inputs": [0]}]
    words = "How many things are there?"
    assert job_name({"scene": scene, "target": {"name": "resnet50"}}) == "cube, couch"
    assert job_name({"scene": scene, "target": {"name": "iep", "ask": {"question": words}}}) == words
    assert job_name({"scene": scene, "target": {"name": "iep", "ask": {"leave_kind": True}}}) == "cube, couch"
    program = "A program of 2 functions that asks for a number"
    assert job_name({"scene": scene, "target": {"name": "iep", "ask": {"question": counting}}}) == program
    several = {"scene": scene, "target": {"name": "iep", "ask": {"questions": [words, counting]}}}
    asked = asked_of(several)
    assert asked is not None
    assert asked.names == (words, program)
    assert job_name(several) == "2 questions about one image"


def test_a_request_of_another_version_is_named_by_its_scene() -> None:
    scene = {"objects": [{"mesh": "primitive/cube"}]}
    assert job_name({"scene": scene, "target": {"name": "iep", "question": "How many things are there?"}}) == "cube"
