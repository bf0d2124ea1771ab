from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from scene_attack_questions.iep.assembly import Question, assemble
from scene_attack_questions.iep.checkpoint import MAX_BYTES, load, to_bytes
from scene_attack_questions.iep.engine import CHANNELS, Network, Trunk
from scene_attack_questions.iep.program_generator import ProgramGenerator
from tests.unit.questions.iep.seeded import program

ASSEMBLY = assemble([Question(program("scene", "filter_size 0 large", "count 1"))])


@pytest.fixture(scope="module")
def network() -> Network:
    """A network whose normalisation has statistics of its own, as after training."""
    torch.manual_seed(0)
    made = Network(48)
    with torch.no_grad():
        made.train()(images(2), ASSEMBLY)
    return made.requires_grad_(False).eval()


def images(count: int) -> torch.Tensor:
    return torch.rand(count, 240, 320, 3, generator=torch.Generator().manual_seed(6))


def test_features_do_not_depend_on_the_other_images(network: Network) -> None:
    several = images(3)
    together, alone = network.trunk(several), network.trunk(several[1:2])
    assert together.shape == (3, CHANNELS, 15, 20)
    assert (together[1:2] - alone).abs().max() < 1e-5 * alone.abs().max()


def test_the_gradient_with_respect_to_the_image_is_that_of_finite_differences(network: Network) -> None:
    own = Network(48).double().eval().requires_grad_(False)
    own.load_state_dict(network.state_dict())
    image = images(1).double().requires_grad_(True)
    score = own(image, ASSEMBLY).scores[0, 4]
    (gradient,) = torch.autograd.grad(score, image)
    direction = torch.randn(image.shape, generator=torch.Generator().manual_seed(8)).double()
    step = 1e-8
    with torch.no_grad():
        above, below = (own(image + sign * step * direction, ASSEMBLY).scores[0, 4] for sign in (1, -1))
    assert float((gradient * direction).sum()) == pytest.approx(float((above - below) / (2 * step)), rel=1e-4)


def test_the_trunk_is_small_and_takes_one_size() -> None:
    trunk = Trunk()
    assert 450_000 < sum(parameter.numel() for parameter in trunk.parameters()) < 550_000
    with pytest.raises(ValueError, match="240, 320"):
        trunk(torch.zeros(1, 224, 320, 3))


def test_weights_come_back_to_half_a_step_of_their_output_and_biases_as_they_were(
    network: Network, tmp_path: Path
) -> None:
    generator = ProgramGenerator()
    data = to_bytes(network, generator)
    assert len(data) < 0.25 * MAX_BYTES
    path = tmp_path / "iep.safetensors"
    path.write_bytes(data)
    found = load(path)
    assert not any(parameter.requires_grad for parameter in found.network.parameters())
    weights = [
        (network.engine.mapping.second, found.network.engine.mapping.second, 2),
        (network.engine.stem.looks.weight, found.network.engine.stem.looks.weight, (1, 2)),
        (network.trunk.layers[1][0].weight, found.network.trunk.layers[1][0].weight, (1, 2, 3)),
        (generator.output.weight, found.generator.output.weight, 1),
    ]
    for before, after, inputs in weights:
        step = before.detach().abs().amax(inputs, keepdim=True) / 127
        off = (after - before.detach()).abs() / step
        assert 0.4 < float(off.max()) < 0.5001
    for (name, before), after in zip(network.named_buffers(), found.network.buffers(), strict=True):
        assert torch.equal(before, after) or name.endswith("num_batches_tracked")
    assert torch.equal(found.network.engine.reading.first.bias, network.engine.reading.first.bias)
    shown = images(1)
    wanted, scores = network(shown, ASSEMBLY).scores, found.network(shown, ASSEMBLY).scores
    assert 0 < float((scores - wanted).norm() / wanted.norm()) < 0.1
    again = tmp_path / "again.safetensors"
    again.write_bytes(to_bytes(found.network, found.generator))
    assert torch.allclose(load(again).network(shown, ASSEMBLY).scores, scores, rtol=1e-4, atol=1e-5)


def test_what_is_no_checkpoint_of_this_code_is_refused(network: Network, tmp_path: Path) -> None:
    data = to_bytes(network, ProgramGenerator())
    path = tmp_path / "iep.safetensors"
    path.write_bytes(data[:-1000])
    with pytest.raises(ValueError, match="cannot be read"):
        load(path)
    with pytest.raises(ValueError, match="cannot be read"):
        load(tmp_path / "nowhere")
    path.write_bytes(data.replace(b"same_color", b"same_hue__"))
    with pytest.raises(ValueError, match=r"other (tokens|modules)"):
        load(path)
    path.write_bytes(data)
    tensors = load_file(path)
    metadata = _metadata(path)
    for missing in ("mapping.mask", ".second.scale"):
        save_file({name: value for name, value in tensors.items() if missing not in name}, path, metadata)
        with pytest.raises(ValueError, match="do not fit"):
            load(path)
    for ending in (".bias", ".scale"):
        name = next(name for name in tensors if name.endswith(ending))
        broken = tensors[name].clone()
        broken.view(-1)[0] = torch.nan
        save_file(tensors | {name: broken}, path, metadata)
        with pytest.raises(ValueError, match=f"{name} has values that are not finite"):
            load(path)


def _metadata(path: Path) -> dict[str, str]:
    from safetensors import safe_open

    with safe_open(path, framework="pt") as file:
        return dict(file.metadata())
