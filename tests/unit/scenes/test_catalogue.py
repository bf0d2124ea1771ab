"""The furniture catalogue: .properties files against an independent writer, fields, licences, slugs, kinds, sizes."""

import zipfile
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scene_attack.scenes.furniture import (
    IDENTITY,
    Model,
    kind_of,
    kinds,
    parse_properties,
    read_archive,
    read_catalogue,
    slugify,
    with_slugs,
)
from scene_attack.scenes.library import Library

HEAD = "id=X\nname=Test Models catalog\nlicense=Creative Commons Attribution 3.0 license\n"


def archive(path, text, files=("m/a.obj", "m/b.obj")):
    with zipfile.ZipFile(path, "w") as out:
        out.writestr("PluginFurnitureCatalog.properties", text.encode("latin-1"))
        for name in files:
            out.writestr(name, "v 0 0 0")


def model(number, title="Chair", size=("10", "20", "30.5"), path="/m/a.obj", **more):
    lines = {
        "id": f"Test#key{number}",
        "name": title,
        "category": "Office",
        "model": path,
        "creator": "Ann",
        **dict(zip(("width", "depth", "height"), size, strict=True)),
        **more,
    }
    return "".join(f"{key}#{number}={value}\n" for key, value in lines.items())


def test_reads_a_model(tmp_path):
    archive(tmp_path / "t.sh3f", HEAD + model(3, "Caf\\u00e9 chair", modelRotation="1 0 0 0 0 1 0 -1 0"))
    (found,) = read_archive(tmp_path / "t.sh3f")
    assert found.title == "Café chair"
    assert found.size == (10.0, 20.0, 30.5)
    assert found.rotation == (1, 0, 0, 0, 0, 1, 0, -1, 0)
    assert (found.key, found.category, found.creator) == ("key3", "Office", "Ann")
    assert (found.library, found.licence, found.path) == ("Test Models", "CC BY 3.0", "m/a.obj")
    assert "Café chair" in found.credit
    assert "Ann" in found.credit
    assert "CC BY 3.0" in found.credit


@pytest.mark.parametrize(
    ("text", "licence"),
    [
        ("Public domain", "CC0 1.0"),
        ("Creative Commons Attribution 3.0 Unported license", "CC BY 3.0"),
        ("Creative Commons Attribution 3.0 United States license", "CC BY 3.0 US"),
        ("Ask Bob", "Ask Bob"),
        ("", "unknown"),
    ],
)
def test_names_the_licence(tmp_path, text, licence):
    archive(tmp_path / "t.sh3f", f"name=T\nlicense={text}\n" + model(1))
    assert read_archive(tmp_path / "t.sh3f")[0].licence == licence


@pytest.mark.parametrize(
    "broken",
    [
        model(2, path="/m/none.obj"),
        model(2, size=("0", "1", "1")),
        model(2, size=("x", "1", "1")),
        model(2, title=" "),
        model(2, path="/m/a.obj.exe"),
    ],
)
def test_leaves_out_models_that_cannot_be_shown(tmp_path, broken):
    archive(tmp_path / "t.sh3f", HEAD + model(1) + broken)
    assert [m.key for m in read_archive(tmp_path / "t.sh3f")] == ["key1"]


def test_a_malformed_rotation_is_none(tmp_path):
    archive(tmp_path / "t.sh3f", HEAD + model(1, modelRotation="1 0 0"))
    assert read_archive(tmp_path / "t.sh3f")[0].rotation == IDENTITY


def test_models_come_in_the_order_of_their_numbers(tmp_path):
    archive(tmp_path / "t.sh3f", HEAD + model(10, "Ten") + model(9, "Nine"))
    assert [m.title for m in read_archive(tmp_path / "t.sh3f")] == ["Nine", "Ten"]


def test_slugs_on_a_clash_take_the_key_then_the_library(tmp_path):
    archive(tmp_path / "a.sh3f", HEAD + model(1) + model(2) + model(3, id="Test#chair3"))
    archive(tmp_path / "b.sh3f", HEAD.replace("Test Models", "Other") + model(2) + model(4, "Grand piano"))
    found = read_catalogue(tmp_path)
    assert list(found) == ["chair", "chair-key2", "chair3", "chair-key2-other", "grand-piano"]
    assert [m.slug for m in found.values()] == list(found)


def test_no_archives_no_models(tmp_path):
    assert read_catalogue(tmp_path / "nothing") == {}


@pytest.mark.parametrize(
    ("text", "slug"), [("Grand piano", "grand-piano"), ("Café (2)", "cafe-2"), ("--", ""), ("ÄB__c", "ab-c")]
)
def test_slugify(text, slug):
    assert slugify(text) == slug


titles = st.text(min_size=1, max_size=6)


@given(st.lists(st.tuples(titles, titles), max_size=20))
def test_slugs_are_unique_plain_and_depend_on_what_came_before_only(pairs):
    models = [
        Model(
            slug="",
            key=key,
            title=title,
            category="c",
            creator="c",
            licence="l",
            library="Lib",
            archive=Path("a"),
            path="p",
            size=(1, 1, 1),
            rotation=IDENTITY,
        )
        for title, key in pairs
    ]
    slugs = [m.slug for m in with_slugs(models)]
    assert len(set(slugs)) == len(slugs)
    assert all(slug and slug == slugify(slug) for slug in slugs)
    assert [m.slug for m in with_slugs(models[: len(models) // 2])] == slugs[: len(models) // 2]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (b"name#1=Armchair", {"name#1": "Armchair"}),
        (b"  name : Chair \n", {"name": "Chair "}),
        (b"name Chair", {"name": "Chair"}),
        (b"# a=b\n! c=d\n\nempty=\nalone", {"empty": "", "alone": ""}),
        (b"a=one, \\\n   two\\\r\n  three", {"a": "one, twothree"}),
        (b"path=c\\:\\\\x\\ty", {"path": "c:\\x\ty"}),
        (b"a\\=b\\ c=d", {"a=b c": "d"}),
        (b"caf\xe9=\\u00e9\\u20AC", {"café": "é€"}),
        (b"a=1\na=2", {"a": "2"}),
        (b"a=x\\\\\nb=y", {"a": "x\\", "b": "y"}),
        (b"a=b=c:d", {"a": "b=c:d"}),
        (b"", {}),
    ],
)
def test_reads_javas_rules(text, expected):
    assert parse_properties(text) == expected


def escape(text, key):
    out = []
    for index, character in enumerate(text):
        if character in "\\=:#!" or (character == " " and (key or index == 0)):
            out.append("\\" + character)
        elif character in "\t\n\r\f":
            out.append({"\t": "\\t", "\n": "\\n", "\r": "\\r", "\f": "\\f"}[character])
        elif " " <= character <= "~":
            out.append(character)
        else:
            out.append(f"\\u{ord(character):04x}")
    return "".join(out)


words = st.text(st.characters(max_codepoint=0xFFFF, exclude_categories=["Cs"]), max_size=12)


@given(st.dictionaries(words, words, max_size=6))
def test_reads_back_what_java_would_write(values):
    text = "\n".join(f"{escape(key, True)}={escape(value, False)}" for key, value in values.items())
    assert parse_properties(text.encode("latin-1")) == values


@given(st.binary(max_size=200))
def test_no_bytes_break_it(data):
    assert all(isinstance(value, str) for value in parse_properties(data).values())


def test_every_model_of_the_table_is_in_the_library(library: Library) -> None:
    there = {entry.name for entry in library.entries()}
    missing = [mesh for meshes in kinds().values() for mesh in meshes if mesh not in there]
    assert missing == []


def test_a_model_has_one_kind() -> None:
    counts = Counter(mesh for meshes in kinds().values() for mesh in meshes)
    assert [mesh for mesh, count in counts.items() if count > 1] == []


def test_kind_of_a_mesh() -> None:
    assert kind_of("furniture/couch") == "sofa"
    assert kind_of("primitive/cube") is None
    assert kind_of("couch") is None, "a mesh is named with its folder"
