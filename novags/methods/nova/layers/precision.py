"""Maps in float32 and bfloat16 for kernels, which compute in float32.

A kernel is written once, with three functions: `read` gives a line of the memory, `place` says where a line of results
is computed, and `write` brings it from there into the memory. For float32 the place is the memory itself.
"""

# mypy: allow-untyped-defs

import numpy as np
import torch
from torch import Tensor

from novags.splats.cpu.compiler import inline


def memory(x: Tensor) -> np.ndarray:
    """The memory of maps [B, D, H, W], channels last, as [B, H, W, D]; bfloat16 as its bits."""
    lines = x.detach().permute(0, 2, 3, 1)
    return lines.numpy() if x.dtype == torch.float32 else lines.view(torch.uint16).numpy()


@inline
def itself(memory, line):
    """`read` and `place` of float32."""
    return memory


@inline
def kept(line, memory):
    """`write` of float32."""


@inline
def widened(memory, line):
    """`read` of bfloat16."""
    bits = line.view(np.uint32)
    for c in range(len(memory)):
        bits[c] = np.uint32(memory[c]) << np.uint32(16)
    return line


@inline
def beside(memory, line):
    """`place` of bfloat16."""
    return line


@inline
def rounded(line, memory):
    """`write` of bfloat16: the nearest, ties to even. A NaN of arithmetic, whose bits lie in this half, stays one."""
    bits = line.view(np.uint32)
    for c in range(len(memory)):
        odd = (bits[c] >> np.uint32(16)) & np.uint32(1)
        memory[c] = np.uint16((bits[c] + np.uint32(0x7FFF) + odd) >> np.uint32(16))
