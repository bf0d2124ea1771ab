from pathlib import Path

import torch

from scene_attack.analysis.images import load_png, magnified, save_png


def test_magnified_five_times_around_128() -> None:
    original = torch.tensor([[[100, 100, 100]]], dtype=torch.uint8)
    attacked = torch.tensor([[[101, 97, 200]]], dtype=torch.uint8)
    assert magnified(original, attacked).tolist() == [[[133, 113, 255]]]
    assert magnified(attacked, original).tolist() == [[[123, 143, 0]]]


def test_png_keeps_every_byte_and_is_itself_reproducible(tmp_path: Path) -> None:
    image = torch.randint(0, 256, (9, 11, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    save_png(image, tmp_path / "a.png")
    save_png(image, tmp_path / "b.png")
    assert torch.equal(load_png(tmp_path / "a.png"), image)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
