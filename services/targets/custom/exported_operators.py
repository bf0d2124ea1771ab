"""Names the torch operators that a .pt2 program may use: those of inference that read and write nothing but tensors.

A program is data from outside. Operators that read files, run code, or leave memory uninitialised are not here.
"""

import operator
from collections.abc import Callable
from typing import Any

import torch

from services.targets.custom.graph import Unreadable

_NAMES = """
conv1d conv2d conv3d convolution conv_transpose2d linear addmm mm bmm matmul baddbmm einsum addbmm mv dot outer
batch_norm _native_batch_norm_legit_no_training layer_norm native_layer_norm group_norm native_group_norm
instance_norm rms_norm
relu relu_ relu6 relu6_ leaky_relu leaky_relu_ elu elu_ selu selu_ celu gelu silu silu_ mish hardtanh hardtanh_
hardswish hardswish_ hardsigmoid hardsigmoid_ sigmoid sigmoid_ tanh tanh_ softplus softmax log_softmax _softmax
_log_softmax logsumexp prelu glu threshold threshold_ log_sigmoid
max_pool2d max_pool2d_with_indices avg_pool2d adaptive_avg_pool2d _adaptive_avg_pool2d adaptive_max_pool2d
avg_pool1d adaptive_avg_pool1d max_pool1d
dropout dropout_ feature_dropout feature_dropout_ alpha_dropout
upsample_nearest2d upsample_bilinear2d upsample_bicubic2d _upsample_bilinear2d_aa _upsample_bicubic2d_aa
grid_sampler affine_grid_generator
scaled_dot_product_attention
add add_ sub sub_ rsub mul mul_ div div_ neg abs pow sqrt rsqrt exp log log2 log1p expm1 sin cos erf clamp clamp_
clamp_min clamp_max minimum maximum where sign floor ceil round trunc reciprocal square fmod remainder lerp addcmul
eq ne lt le gt ge logical_and logical_or logical_not masked_fill masked_fill_
mean sum amax amin max min argmax argmin prod var var_mean std norm linalg_vector_norm cumsum topk sort any all
view reshape flatten unflatten permute transpose t squeeze unsqueeze expand expand_as repeat repeat_interleave cat
concat stack split split_with_sizes chunk unbind select slice narrow index index_select gather pad constant_pad_nd
reflection_pad2d replication_pad2d roll flip contiguous clone detach detach_ to _to_copy type_as alias view_as
reshape_as unfold im2col pixel_shuffle pixel_unshuffle channel_shuffle native_channel_shuffle movedim embedding
lift_fresh_copy numpy_T swapaxes swapdims meshgrid broadcast_tensors
zeros ones full arange linspace zeros_like ones_like full_like scalar_tensor new_zeros new_ones new_full eye tril
triu one_hot sym_size sym_numel _assert_tensor_metadata _assert_scalar
"""
_ATEN = frozenset(_NAMES.split())
_SHAPES: dict[str, Callable[..., Any]] = {
    name: getattr(operator, name)
    for name in ("add", "sub", "mul", "floordiv", "truediv", "mod", "neg", "eq", "ne", "lt", "le", "gt", "ge")
}
"""Arithmetic on lengths of a shape."""


def operator_of(target: str) -> Callable[..., Any]:
    """Returns the operator of a name such as "torch.ops.aten.conv2d.default". Raises Unreadable, naming it, if it is
    none that a program may use.
    """
    if target.startswith("_operator.") and target.removeprefix("_operator.") in _SHAPES:
        return _SHAPES[target.removeprefix("_operator.")]
    parts = target.split(".")
    if len(parts) == 5 and parts[:3] == ["torch", "ops", "aten"] and parts[3] in _ATEN and "out" not in parts[4]:
        packet = getattr(torch.ops.aten, parts[3], None)
        if packet is not None and parts[4] in packet.overloads():
            found: Callable[..., Any] = getattr(packet, parts[4])
            return found
    raise Unreadable(f"it uses the operator {target!r:.120}, which is not among those that a .pt2 program may use here")


def changes_its_input(target: str) -> bool:
    """Whether the operator writes its result over its first input."""
    return target.split(".")[3:4] != [] and target.split(".")[3].endswith("_")
