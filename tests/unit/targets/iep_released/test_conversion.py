"""The conversion of released checkpoints: what is read, what is refused, and that the service reads no pickle."""

import hashlib
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file
from typer.testing import CliRunner

from client import clevr_iep
from client.cli import app
from services.errors import InvalidRequest
from services.pipeline.target_folders import register_folders
from services.targets import registry
from tests.unit.targets.custom.registries import restored
from tests.unit.targets.iep_released.conftest import Published


def test_files_of_2017_and_of_today_give_the_same_folder(made: Published, root: Path, tmp_path: Path) -> None:
    for name in ("engine", "generator"):
        torch.save(getattr(made, name), tmp_path / f"{name}.pt")
    folder = made.converted(tmp_path / "out", engine=tmp_path / "engine.pt", generator=tmp_path / "generator.pt")
    for name in ("model.safetensors", "card.json"):
        assert (folder / name).read_bytes() == (root / "released" / name).read_bytes()
    weights = load_file(folder / "model.safetensors")
    assert torch.equal(weights["trunk.layer3.1.conv2.weight"], made.trunk["layer3.1.conv2.weight"])
    of_engine = made.engine["execution_engine_state"]
    assert torch.equal(weights["engine.functions.relate[left].conv1.bias"], of_engine["relate[left].conv1.bias"])
    assert not [name for name in weights if "layer4" in name or "fc." in name or "<" in name]


def test_the_service_reads_no_pickle(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("a pickle was read")

    with restored(monkeypatch):
        monkeypatch.setattr(torch, "load", never)
        monkeypatch.setattr(pickle, "load", never)
        monkeypatch.setattr(pickle, "loads", never)
        monkeypatch.setattr(pickle, "Unpickler", never)
        assert [one.error for one in register_folders(root)] == [None]
        assert registry.load("released").takes_question


class Code:
    """Runs code when it is unpickled."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str, ...]]:
        return os.mkdir, ("was-run",)


def without(made: dict[str, Any], part: str, name: str) -> dict[str, Any]:
    return made | {part: {key: value for key, value in made[part].items() if key != name}}


def settings(made: dict[str, Any], **changes: Any) -> dict[str, Any]:
    return made | {"execution_engine_kwargs": made["execution_engine_kwargs"] | changes}


def vocabulary(made: dict[str, Any], kind: str, change: Callable[[dict[str, int]], dict[str, int]]) -> dict[str, Any]:
    name = f"{kind}_token_to_idx"
    return made | {"vocab": made["vocab"] | {name: change(dict(made["vocab"][name]))}}


def swapped(numbers: dict[str, int]) -> dict[str, int]:
    return numbers | {"count": numbers["exist"], "exist": numbers["count"]}


def renamed(old: str) -> Callable[[dict[str, int]], dict[str, int]]:
    return lambda numbers: {("other" if token == old else token): number for token, number in numbers.items()}


REFUSED: dict[str, tuple[str, str, Callable[[Published], Any]]] = {
    "code": ("engine", "cannot be read as weights", lambda of: of.engine | {"args": Code()}),
    "no dictionary": ("generator", "holds a list, not a dictionary", lambda _: [1]),
    "another checkpoint": ("engine", "it has no execution_engine_kwargs", lambda of: of.generator),
    "another stem": ("engine", "stem_batchnorm is True", lambda of: settings(of.engine, stem_batchnorm=True)),
    "a weight missing": (
        "engine",
        "engine: it lacks functions.count.conv2.bias",
        lambda of: without(of.engine, "execution_engine_state", "count.conv2.bias"),
    ),
    "no stem": (
        "engine",
        "it lacks stem.0.weight",
        lambda of: without(of.engine, "execution_engine_state", "stem.0.weight"),
    ),
    "other functions": (
        "generator",
        "functions are not those of the engine",
        lambda of: vocabulary(of.generator, "program", swapped),
    ),
    "an answer missing": (
        "engine",
        "its answers lack 'cyan'",
        lambda of: vocabulary(of.engine, "answer", renamed("cyan")),
    ),
    "numbers missing": (
        "engine",
        "not numbered from 0",
        lambda of: vocabulary(of.engine, "answer", lambda numbers: numbers | {"cyan": 40}),
    ),
    "another trunk": (
        "trunk",
        "they have 1 and 64 features",
        lambda of: of.trunk | {"layer3.0.conv3.weight": torch.zeros(1, 2, 1, 1)},
    ),
    "a weight without dimensions": (
        "trunk",
        r"layer3.0.conv3.weight has the shape \[\]; one of 4 dimensions",
        lambda of: of.trunk | {"layer3.0.conv3.weight": torch.tensor(1.0)},
    ),
    "no trunk": ("trunk", "it lacks layer3.0.conv3.weight", lambda _: {"conv1.weight": torch.zeros(4)}),
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_what_is_not_the_published_network_is_refused(
    made: Published, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mistake: str
) -> None:
    monkeypatch.chdir(tmp_path)
    option, said, change = REFUSED[mistake]
    torch.save(change(made), tmp_path / "bad.pt")
    with pytest.raises(InvalidRequest, match=said):
        made.converted(tmp_path / "out", **{option: tmp_path / "bad.pt"})
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "was-run").exists()


def test_the_command_takes_the_trunk_of_the_training_only(
    made: Published, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [
        word for name in ("engine", "generator", "trunk") for word in (f"--{name}", str(made.folder / f"{name}.pt"))
    ]
    command = ["targets", "convert-clevr-iep", *files, "--out", str(tmp_path / "mine")]
    refused = CliRunner().invoke(app, command)
    digest = hashlib.sha256((made.folder / "trunk.pt").read_bytes()).hexdigest()
    assert isinstance(refused.exception, InvalidRequest)
    assert f"begins with {digest[:8]}" in str(refused.exception)
    monkeypatch.setattr(clevr_iep, "TRUNKS", (digest[:8],))
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert sorted(one.name for one in (tmp_path / "mine").iterdir()) == ["card.json", "model.safetensors"]
    again = CliRunner().invoke(app, command)
    assert isinstance(again.exception, InvalidRequest)
    assert "not empty" in str(again.exception)


SIZED = (
    ("trunk", "conv1.weight"),
    ("trunk", "layer3.0.conv3.weight"),
    ("engine", "stem.0.weight"),
    ("engine", "classifier.0.weight"),
    ("engine", "classifier.4.weight"),
    ("engine", "classifier.6.weight"),
    ("generator", "encoder_embed.weight"),
    ("generator", "decoder_embed.weight"),
    ("generator", "decoder_linear.weight"),
)
"""The weights from whose shapes the network's sizes follow."""


def test_a_folder_that_does_not_fit_is_refused(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from safetensors import safe_open
    from safetensors.torch import save_file

    model = root / "released" / "model.safetensors"
    with safe_open(model, framework="pt") as file:
        metadata = dict(file.metadata())
    weights = load_file(model)
    card = (root / "released" / "card.json").read_text()
    mistakes = {
        "no-metadata": (weights, {}, card, "its metadata has no vocabulary"),
        "no-weight": (
            {name: value for name, value in weights.items() if name != "generator.decoder_linear.bias"},
            *(metadata, card, "generator: it lacks decoder_linear.bias"),
        ),
        "probabilities": (weights, metadata, card.replace("{", '{"output": "probabilities",', 1), "returns scores"),
        "other-labels": (
            weights,
            metadata,
            card.replace('"clevr"', '["a", "b"]'),
            "28 labels .* not the 2 of its card",
        ),
        "other-size": (weights, metadata, card.replace("224,\n   224", "160,\n   160"), "fails on 2 RGB images"),
    }
    for part, weight in SIZED:
        for tensor in (torch.tensor(0.5), torch.zeros(3)):
            mistakes[f"{part}-{weight.replace('.', '-')}-{tensor.dim()}"] = (
                weights | {f"{part}.{weight}": tensor},
                *(metadata, card, rf"{weight} has the shape \[3?\]; one of [24] dimensions"),
            )
    for bad in (torch.nan, torch.inf, -torch.inf):
        broken = weights["engine.classifier.6.bias"].clone()
        broken[3] = bad
        mistakes[f"not-finite-{bad}"] = (
            weights | {"engine.classifier.6.bias": broken},
            *(metadata, card, "engine.classifier.6.bias has values that are not finite"),
        )
    for name, (tensors, about, written, _) in mistakes.items():
        (tmp_path / name).mkdir()
        save_file(tensors, tmp_path / name / "model.safetensors", about)
        (tmp_path / name / "card.json").write_text(written)
    with restored(monkeypatch):
        assert [one.error for one in register_folders(tmp_path)] == [None] * len(mistakes)
        for name, (*_, said) in mistakes.items():
            with pytest.raises(InvalidRequest, match=said):
                registry.load(name)


def test_a_refused_pickle_is_not_recommended_to_be_read_unsafely(made: Published, tmp_path: Path) -> None:
    """torch's message says how to read the file so that its code runs, before it says what is wrong with it."""
    torch.save(made.engine | {"args": Code()}, tmp_path / "code.pt")
    (tmp_path / "plain.pt").write_bytes(pickle.dumps(print, protocol=2))
    for name, reason in (("code.pt", r"GLOBAL \w+\.mkdir"), ("plain.pt", "cannot be read as weights")):
        with pytest.raises(InvalidRequest, match=reason) as refused:
            made.converted(tmp_path / "out", engine=tmp_path / name)
        assert "weights_only" not in refused.value.detail
        assert "add_safe_globals" not in refused.value.detail
