"""Replaces the convolutions of a network by packed convolutions, after checking that they compute the same.

Every frozen `nn.Conv2d` is packed. If it is in an `nn.Sequential`, a batch normalisation that follows it is folded in
(in evaluation it is an affine map), and a ReLU or ReLU6 that follows is fused.
"""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass

import structlog
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from services.targets import onednn
from services.targets.packed import ACTIVATIONS, PackedConvolution, Padding, Pair
from services.targets.same_padding import SameConv2d

TOLERANCE = 1e-5
"""Largest ‖packed − plain‖ / ‖plain‖ of a layer's values and of its derivative; rounding in float32 is some 1e-6."""
KINK = 1e-3
"""Distance from an activation's bounds within which derivatives are not compared, as rounding decides them there."""


@dataclass(frozen=True)
class Site:
    """A convolution in its parent module: the names of the convolution and of the layers to fuse with it."""

    parent: nn.Module
    names: tuple[str, ...]

    @property
    def modules(self) -> list[nn.Module]:
        """The modules of these names: a convolution, perhaps a batch normalisation, perhaps an activation."""
        return [getattr(self.parent, name) for name in self.names]


def to_channels_last(network: nn.Module) -> None:
    """Lays out the four-dimensional weights of a network channels last. `nn.Module.to` fails if others have five."""
    for value in [*network.parameters(), *network.buffers()]:
        if value.dim() == 4:
            value.data = value.data.contiguous(memory_format=torch.channels_last)


def pack(network: nn.Module, size: Pair) -> bool:
    """Replaces the convolutions of a frozen float32 network on the CPU by packed ones; returns whether it did.

    The packed network is for images of `size` (height, width) in channels_last. On failure the network is unchanged.

    Scores and gradients change by rounding only: a layer of each kind is compared with the plain layer first.
    """
    if not onednn.available():
        return False
    sites = [site for site in _sites(network) if not site.modules[0].weight.requires_grad]
    try:
        with torch.no_grad():
            sizes = _input_sizes(network, [site.modules[0] for site in sites], size)
            made = [(site, _packed(site, sizes[site.modules[0]])) for site in sites if site.modules[0] in sizes]
        trouble = _trouble([packed for _, packed in made if packed is not None])
    except (RuntimeError, AttributeError, TypeError, NotImplementedError) as error:  # the operators changed
        trouble = repr(error)
    if trouble:
        structlog.get_logger().warning("convolutions are not packed and run up to half as fast", error=trouble)
        return False
    for site, packed in made:
        if packed is not None:
            setattr(site.parent, site.names[0], packed)
            for name in site.names[1:]:
                setattr(site.parent, name, nn.Identity())
    return True


def relative_errors(packed: PackedConvolution, batch: int = 1) -> tuple[float, float]:
    """Returns ‖packed − plain‖ / ‖plain‖ of values and of the derivative by the input, at random inputs."""
    random = torch.Generator().manual_seed(0)
    x = torch.randn(batch, packed.weight.shape[1] * packed.groups, *packed.size, generator=random)
    x = x.contiguous(memory_format=torch.channels_last)
    plain, ours = x.clone().requires_grad_(), x.clone().requires_grad_()
    with torch.enable_grad():
        wanted, found = packed.plain(plain), packed(ours)
        grad_output = torch.randn(wanted.shape, generator=random)
        for bound in packed.clamp or ():
            grad_output = grad_output * ((wanted.detach() - bound).abs() > KINK)
        # Gradients of a scalar: for any other value torch imports sympy, which takes 30 MiB and half a second.
        wanted_slope, found_slope = (
            torch.autograd.grad((y * grad_output).sum(), leaf)[0] for y, leaf in ((wanted, plain), (found, ours))
        )
    return _relative(found, wanted), _relative(found_slope, wanted_slope)


def _relative(found: Tensor, wanted: Tensor) -> float:
    found, wanted = found.detach(), wanted.detach()
    return float((found - wanted).norm() / wanted.norm().clamp_min(torch.finfo(wanted.dtype).tiny))


def _sites(module: nn.Module) -> Iterator[Site]:
    """Yields the convolutions under a module, each with the layers that follow it and can be fused."""
    if isinstance(module, PackedConvolution):
        return
    names = [name for name, _ in module.named_children()]
    in_sequence = type(module).forward is nn.Sequential.forward
    for place, name in enumerate(names):
        child = getattr(module, name)
        if type(child) not in (nn.Conv2d, SameConv2d):
            yield from _sites(child)
            continue
        taken, rest = [name], names[place + 1 :] if in_sequence else []
        if rest and _foldable(getattr(module, rest[0])):
            taken.append(rest.pop(0))
        if rest and type(getattr(module, rest[0])) in ACTIVATIONS:
            taken.append(rest.pop(0))
        yield Site(module, tuple(taken))


def _foldable(module: nn.Module) -> bool:
    return type(module) is nn.BatchNorm2d and not module.training and module.running_mean is not None


def _input_sizes(network: nn.Module, convolutions: list[nn.Module], size: Pair) -> dict[nn.Module, Pair]:
    """Returns height and width of the input of each convolution that an image of `size` reaches."""
    sizes: dict[nn.Module, Pair] = {}

    def note(convolution: nn.Module, inputs: tuple[Tensor, ...]) -> None:
        sizes[convolution] = (inputs[0].shape[2], inputs[0].shape[3])

    hooks = [convolution.register_forward_pre_hook(note) for convolution in convolutions]
    try:
        network(torch.zeros(1, 3, *size).contiguous(memory_format=torch.channels_last))
    finally:
        for hook in hooks:
            hook.remove()
    return sizes


def _packed(site: Site, size: Pair) -> PackedConvolution | None:
    """Returns the packed convolution for a site; None if its padding is not supported."""
    convolution, *others = site.modules
    assert isinstance(convolution, nn.Conv2d)
    padding = Padding.of(convolution, size)
    if padding is None:
        return None
    plain = nn.Sequential(*site.modules)
    if others and isinstance(others[0], nn.BatchNorm2d):
        wide = fuse_conv_bn_eval(deepcopy(convolution).double(), deepcopy(others[0]).double())
        convolution = wide.float()
        del others[0]
    return PackedConvolution(convolution, padding, others[0] if others else None, plain, size)


def _trouble(layers: list[PackedConvolution]) -> str:
    """Returns the error of packed layers as a sentence, tested on the smallest layer of each kind; empty if none."""
    kinds: dict[object, PackedConvolution] = {}
    for layer in sorted(layers, key=lambda layer: layer.size):
        kind = (layer.weight[0, 0].numel() > 1, layer.stride, layer.dilation, layer.groups > 1, layer.clamp)
        kinds.setdefault(kind, layer)
    for layer in kinds.values():
        errors = relative_errors(layer)
        if not max(errors) <= TOLERANCE:  # also true for NaN
            return f"a packed convolution is off by {errors[0]:.1e} in its values, {errors[1]:.1e} in its derivative"
    return ""
