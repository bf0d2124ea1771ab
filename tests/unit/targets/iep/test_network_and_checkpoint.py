from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from services.questions.program import Node, Program
from services.targets.iep.assembly import Question, assemble
from services.targets.iep.checkpoint import MAX_BYTES, load, to_bytes
from services.targets.iep.network import Network
from services.targets.iep.program_generator import ProgramGenerator
from services.targets.iep.trunk import CHANNELS, Trunk

ASSEMBLY = assemble(
    [Question(Program((Node("scene", (), ()), Node("filter_size", (0,), ("large",)), Node("count", (1,), ()))))]
)


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


def test_a_checkpoint_comes_back_bit_for_bit(network: Network, tmp_path: Path) -> None:
    generator = ProgramGenerator()
    data = to_bytes(network, generator)
    assert len(data) < 0.7 * MAX_BYTES
    path = tmp_path / "iep.safetensors"
    path.write_bytes(data)
    found = load(path)
    assert torch.equal(found.generator.output.weight, generator.output.weight)
    assert not any(parameter.requires_grad for parameter in found.network.parameters())
    shown = images(1)
    assert torch.equal(found.network(shown, ASSEMBLY).scores, network(shown, ASSEMBLY).scores)


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
    save_file({name: value for name, value in tensors.items() if "mapping.mask" not in name}, path, _metadata(path))
    with pytest.raises(ValueError, match="do not fit"):
        load(path)


def _metadata(path: Path) -> dict[str, str]:
    from safetensors import safe_open

    with safe_open(path, framework="pt") as file:
        return dict(file.metadata())
