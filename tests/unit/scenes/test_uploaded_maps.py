"""Environment maps that users upload: what is read of a file, what is refused, and how scenes name them."""

import tempfile
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.scenes import environment
from scene_attack.scenes.bundle import About, Bundle
from scene_attack.scenes.environment import average, from_image, read_map
from scene_attack.scenes.library import Library
from scene_attack.scenes.reading.isolated import reader
from tests.unit.scenes.mesh_files import BOXES

TEXELS = np.random.default_rng(3).gamma(0.5, 2.0, (8, 16, 3)).astype(np.float32)


def exr(texels, channels="RGB"):
    """An OpenEXR image of float32 texels."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    planes = {name: np.ascontiguousarray(texels[..., k], np.float32) for k, name in enumerate(channels)}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.exr"
        OpenEXR.File(header, planes).write(str(path))
        return path.read_bytes()


def rgbe(texels):
    """Mantissas and exponents of texels."""
    _, exponent = np.frexp(texels.max(axis=-1))
    mantissa = np.floor(texels * np.ldexp(1.0, 8 - exponent)[..., None])
    return np.concatenate([mantissa, (exponent + 128)[..., None]], axis=-1).astype(np.uint8)


def hdr(texels, *, runs=True, exposure=""):
    """A Radiance picture, whose rows are run-length encoded or flat."""
    height, width = texels.shape[:2]
    out = f"#?RADIANCE\n{exposure}FORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    for row in rgbe(texels):
        if not runs:
            out += row.tobytes()
            continue
        out += bytes([2, 2, width >> 8, width & 255])
        for channel in row.T:
            if (channel == channel[0]).all():
                out += bytes([128 + width, channel[0]])
            else:
                out += bytes([width]) + channel.tobytes()
    return out


@pytest.mark.parametrize(
    ("kind", "data", "error"),
    [
        ("exr", exr(TEXELS), 0),
        ("exr", exr(np.concatenate([TEXELS, TEXELS[..., :1]], axis=-1), "RGBA"), 0),
        ("hdr", hdr(TEXELS), 1 / 128),
        ("hdr", hdr(TEXELS, runs=False), 1 / 128),
        ("hdr", hdr(TEXELS * 4, exposure="EXPOSURE=2\nEXPOSURE= 2\n"), 1 / 128),
    ],
)
def test_a_map_is_read_in_both_formats(kind, data, error):
    for read in (read_map, reader().read_map):
        texels = read(data, kind)
        assert texels.dtype == np.float32
        assert (np.abs(texels - TEXELS) <= error * TEXELS.max(axis=-1, keepdims=True)).all()


def test_a_black_texel_is_black_and_a_run_is_read():
    texels = np.full((2, 8, 3), 0.5, np.float32)
    texels[1] = 0
    assert np.abs(read_map(hdr(texels), "hdr") - texels).max() <= 0.5 / 128
    assert (read_map(hdr(texels), "hdr")[1] == 0).all()


def broken(value):
    texels = TEXELS.copy()
    texels[2, 3, 1] = texels[5, 5, 0] = value
    return texels


BAD = {
    "negative texels": ("exr", exr(broken(-0.25)), "file: 2 of its texels are negative"),
    "infinite texels": ("exr", exr(broken(np.inf)), "file: 2 of its texels are not finite"),
    "NaN": ("exr", exr(broken(np.nan)), "file: 2 of its texels are not finite"),
    "a negative exposure": ("hdr", hdr(TEXELS, exposure="EXPOSURE=-1\n"), r"file: \d+ of its texels are negative"),
    "no exposure": ("hdr", hdr(TEXELS, exposure="EXPOSURE=0\n"), "are not finite"),
    "a word": ("hdr", hdr(TEXELS, exposure="EXPOSURE=much\n"), "its EXPOSURE is 'much', which is no number"),
    "no channel": ("exr", exr(TEXELS[..., :2], "RG"), "no channel B"),
    "text": ("hdr", b"hello", "#.RADIANCE"),
    "text as exr": ("exr", b"hello", "exr map: it is damaged, or cut off$"),
    "cut off": ("hdr", hdr(TEXELS)[:-9], "cut off"),
    "an exr cut off": ("exr", exr(TEXELS)[:200], "exr map: it is damaged, or cut off$"),
    "a size beyond its bytes": ("hdr", hdr(TEXELS).replace(b"-Y 8 +X 16", b"-Y 4096 +X 8192"), "cut off"),
    "too many texels": ("hdr", hdr(TEXELS).replace(b"-Y 8 +X 16", b"-Y 99999 +X 99999"), "at most 33,554,432"),
    "another orientation": ("hdr", hdr(TEXELS).replace(b"-Y 8 +X 16", b"+Y 8 +X 16"), "-Y <height>"),
    "a run beyond its row": ("hdr", hdr(TEXELS).replace(bytes([2, 2, 0, 16, 16]), bytes([2, 2, 0, 16, 17]), 1), "run"),
    "xyz": ("hdr", hdr(TEXELS).replace(b"rle_rgbe", b"rle_xyze"), "FORMAT"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_map_is_refused_by_name(case):
    kind, data, said = BAD[case]
    for read in (read_map, reader().read_map):
        with pytest.raises(InvalidRequest, match=said) as error:
            read(data, kind)
        assert error.value.field == "file"


def test_a_large_map_is_averaged_and_keeps_its_light(monkeypatch):
    monkeypatch.setattr(environment, "MAX_ROWS", 4)
    reduced = read_map(exr(TEXELS), "exr")
    assert reduced.shape == (4, 8, 3)
    whole = average(TEXELS, 1, 1)
    assert np.allclose(average(reduced, 1, 1), whole, rtol=0.02)


def test_an_uploaded_map_lights_scenes_by_its_name_and_with_its_own_credit(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    about = About(title="Garden", licence="CC BY 4.0", credit="Garden by Ada")
    entry = library.add(Bundle("exr", exr(TEXELS), {}, about))
    assert (entry.kind, entry.title, entry.licence, entry.credit) == (
        "environment",
        "Garden",
        "CC BY 4.0",
        "Garden by Ada",
    )
    assert (entry.used, entry.notes, entry.triangles) == (("16×8 texels",), (), None)
    found = Library(tmp_path / "cache", tmp_path / "data").environment(entry.name)
    assert np.array_equal(found.radiance, from_image(TEXELS))
    assert (found.name, found.credit) == (entry.name, "Garden by Ada")
    assert library.add(Bundle("exr", exr(TEXELS), {})).credit is None
    square = library.add(Bundle("exr", exr(TEXELS[:, :8]), {}))
    assert square.notes == ("it has 8×8 texels, and is shown as if it were twice as wide",)


def test_a_mesh_is_no_map_and_a_map_no_mesh(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    of_map, mesh = library.add(Bundle("exr", exr(TEXELS), {})).name, library.add_mesh(BOXES["obj"], "obj").name
    with pytest.raises(InvalidRequest, match=r"environment: there is no environment map 'sha256:"):
        library.environment(mesh)
    with pytest.raises(InvalidRequest, match=r"mesh: .* is an environment map, for lights\.environment\.map"):
        library.mesh(of_map)


def test_of_a_map_that_somebody_put_into_the_folder_no_credit_is_guessed(tmp_path):
    folder = tmp_path / "cache" / "environments"
    folder.mkdir(parents=True)
    for name in ("studio", "mine"):
        (folder / f"{name}.exr").write_bytes(exr(TEXELS))
    library = Library(tmp_path / "cache", tmp_path / "data")
    entries = {entry.name: entry for entry in library.environments()}
    assert "Greg Zaal" in (entries["studio"].credit or "")
    assert (entries["mine"].creator, entries["mine"].licence, entries["mine"].credit) == ("unknown", "unknown", None)
    assert library.environment("mine").credit is None
