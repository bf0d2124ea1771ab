import pytest

from services.scenes.reading.companion_files import Named, collada_images

IMAGES = """<library_images>
<image id="wood" name="w"><init_from> wood%20grain.png </init_from></image>
<image id="bumps"><init_from><ref>bumps &amp; dents.png</ref></init_from></image>
<image id="spare"><init_from>spare.png</init_from></image>
<image_source id="no"><init_from>no.png</init_from></image_source>
</library_images>"""
EFFECT = """<effect id="e"><profile_COMMON>
<newparam sid="surface"><surface type="2D"><init_from>wood</init_from></surface></newparam>
<newparam sid="sampler"><sampler2D><source>surface</source></sampler2D></newparam>
<technique><phong><diffuse><texture texture="sampler" texcoord="UV"/></diffuse>
<bump bumptype="x"> <texture texture="bumps"/></bump></phong></technique></profile_COMMON></effect>"""


def test_images_are_named_by_what_they_are_to_an_effect() -> None:
    assert collada_images((IMAGES + EFFECT).encode()) == [
        Named("wood%20grain.png", "texture"),
        Named("bumps & dents.png", "bump map"),
        Named("spare.png", "image"),
    ]


@pytest.mark.parametrize(
    "text",
    [
        '<image id="a">' * 200_000,
        "<effect " * 300_000,
        '<newparam sid="a">' * 100_000,
        "<effect>" + '<newparam sid="a">' * 100_000 + "</effect>",
        "<effect>" + "<diffuse " * 200_000 + "</effect>",
        '<image id="a"><init_from>' + " " * 2_000_000 + "</image>",
        "</image>" * 300_000,
    ],
    ids=["image", "effect", "newparam", "newparam of an effect", "slot", "blanks", "ends"],
)
def test_beginnings_without_an_end_are_read_at_once(text: str) -> None:
    """Looking for an end from each beginning took a minute and a half, and held up the uploads of everybody."""
    assert collada_images(text.encode()) == []
