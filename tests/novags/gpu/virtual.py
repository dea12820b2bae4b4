"""A GPU without a GPU: tensors that say they are on cuda:0, and are computed on the CPU.

Inside `virtual_gpu()` a tensor that is moved to "cuda", or made there, is a `Virtual`. It refuses what a tensor on a
real GPU refuses: other tensors from the CPU in the same operation, random numbers of a CPU's generator, `.numpy()`. And
it counts what makes the host wait for a GPU: every number that Python, or the shape of a result, needs to know.

Three things it cannot see: kernels that give other bits than a CPU's, mixed devices inside a backward pass (there torch
itself makes tensors, on the device that it believes in), and what gsplat does inside (`stand_in.py` takes its place).
"""

import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from torch.overrides import TorchFunctionMode

CUDA = torch.device("cuda", 0)
CODE = str(Path(__file__).resolve().parents[3] / "novags") + os.sep
aten = torch.ops.aten

# The host has to know a number, or the size of what comes out.
WAITS = {
    aten._local_scalar_dense.default, aten.nonzero.default, aten.equal.default, aten.masked_select.default,
    aten._unique2.default, aten.unique_dim.default, aten.unique_consecutive.default, aten.bincount.default,
    aten._linalg_check_errors.default, aten.repeat_interleave.Tensor,
}  # fmt: skip
INDEXING = {
    aten.index.Tensor, aten.index_put.default, aten.index_put_.default, aten._index_put_impl_.default,
    aten._unsafe_index.Tensor,
}  # fmt: skip
COPIES = {aten.copy_.default, aten._to_copy.default}


class Wrong(RuntimeError):
    """What a real GPU would not do."""


class Waits(Counter[str]):
    """How often each line of the package made the host wait."""

    counting = True

    def note(self) -> None:
        if self.counting:
            self[place()] += 1

    @contextmanager
    def ignored(self) -> Iterator[None]:
        """Not counted in here."""
        before, self.counting = self.counting, False
        try:
            yield
        finally:
            self.counting = before


WAITED = Waits()


def place() -> str:
    """The innermost line of the package that is being executed."""
    frame = sys._getframe()
    while frame is not None:
        if frame.f_code.co_filename.startswith(CODE):
            return f"{frame.f_code.co_filename.removeprefix(CODE)}:{frame.f_lineno}"
        frame = frame.f_back  # type: ignore[assignment]
    return "?"


class Virtual(torch.Tensor):
    """A tensor on the virtual GPU; `inner` is the one on the CPU that holds its numbers."""

    inner: torch.Tensor

    @staticmethod
    def __new__(cls, inner: torch.Tensor) -> "Virtual":
        found = torch.Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
            cls, inner.shape, strides=inner.stride(), storage_offset=inner.storage_offset(), dtype=inner.dtype
        )
        found.inner = inner
        return found

    device = property(lambda self: CUDA)  # type: ignore[assignment]
    is_cuda = property(lambda self: True)  # type: ignore[assignment]
    is_cpu = property(lambda self: False)  # type: ignore[assignment]

    def __repr__(self, **_: Any) -> str:
        return f"Virtual({self.inner})"

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return executed(func, args, kwargs or {})


def plain(value: Any) -> Any:
    """The numbers behind virtual tensors, in lists too; anything else as it is."""
    if isinstance(value, Virtual):
        return value.inner
    return [plain(x) for x in value] if isinstance(value, (list, tuple)) else value


def tensors_in(values: Any) -> Iterator[torch.Tensor]:
    """The tensors among arguments, in lists too."""
    for value in values:
        if isinstance(value, torch.Tensor):
            yield value
        elif isinstance(value, (list, tuple)):
            yield from tensors_in(value)


def executed(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """Run an operation that a virtual tensor takes part in."""
    given = [*tensors_in(args), *tensors_in(kwargs.values())]
    refuse_mixture(func, args, given)
    by_mask = func in INDEXING and any(i is not None and i.dtype in (torch.bool, torch.uint8) for i in args[1])
    brought = func is aten.copy_.default and not isinstance(args[0], Virtual)
    if func in WAITS or by_mask or brought:
        WAITED.note()
    if "device" in kwargs:
        kwargs = {**kwargs, "device": torch.device("cpu")}
    out = func(*map(plain, args), **{name: plain(value) for name, value in kwargs.items()})
    if brought:
        return args[0]
    known = {id(x.inner): x for x in given if isinstance(x, Virtual)}

    def returned(x: Any) -> Any:
        if isinstance(x, torch.Tensor):
            return known[id(x)] if id(x) in known else Virtual(x)
        return [returned(each) for each in x] if isinstance(x, (list, tuple)) else x

    return tuple(returned(out)) if isinstance(out, tuple) else returned(out)


def refuse_mixture(func: Any, args: Any, given: list[torch.Tensor]) -> None:
    """Raise for tensors of two devices, but where a GPU takes them: copies, numbers, indices from the CPU."""
    strangers = [x for x in given if not isinstance(x, Virtual) and x.ndim]
    if func in INDEXING and isinstance(args[0], Virtual):
        values = [x for x in args[2:3] if isinstance(x, torch.Tensor)]
        strangers = [x for x in strangers if any(x is value for value in values)]
    inside_backward = torch._C._current_autograd_node() is not None
    if strangers and func not in COPIES and not inside_backward:
        raise Wrong(
            f"expected all tensors on one device, got a tensor {list(strangers[0].shape)} on the CPU and others on "
            f"cuda:0, for {func} at {place()}"
        )


def refuse_generator(generator: torch.Generator | None, device: torch.device) -> None:
    """Raise where random numbers of one device are wanted from the generator of another."""
    if generator is not None and generator.device.type != device.type:
        raise Wrong(f"expected a generator on {device.type}, got one on {generator.device.type}, at {place()}")


class Generator(torch._C.Generator):
    """A generator that knows which device it was made for; both give a CPU's numbers."""

    made_for: torch.device

    def __new__(cls, device: Any = "cpu") -> "Generator":
        found = super().__new__(cls)
        found.made_for = torch.device(device)
        return found

    def __init__(self, device: Any = "cpu") -> None:
        pass

    @property
    def device(self) -> torch.device:
        return self.made_for


class _Move(torch.autograd.Function):
    """To the other device."""

    @staticmethod
    def forward(ctx: Any, tensor: torch.Tensor, there: bool, kind: torch.dtype) -> torch.Tensor:
        ctx.here, ctx.kind = isinstance(tensor, Virtual), tensor.dtype
        return _moved(tensor, there, kind)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> Any:
        return _moved(gradient, ctx.here, ctx.kind), None, None


def _moved(tensor: torch.Tensor, there: bool, kind: torch.dtype) -> torch.Tensor:
    if isinstance(tensor, Virtual) and not there:
        WAITED.note()
    with torch.no_grad(), torch._C.DisableTorchFunctionSubclass():
        copy = plain(tensor).detach().to(kind, copy=True)
    return Virtual(copy) if there else copy


class _Calls(TorchFunctionMode):
    """What a torch without CUDA would refuse before any dispatch, and what a `Virtual` must not give away."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs, name = dict(kwargs or {}), getattr(func, "__name__", "")
        first = args[0] if args else None
        if isinstance(first, torch.Tensor) and name in ("to", "cpu", "cuda"):
            return self._to(func, name, args, kwargs)
        if isinstance(first, Virtual) and name in ("numpy", "__array__", "data_ptr"):
            raise Wrong(f"can't convert a cuda:0 tensor to numpy, at {place()}")
        if isinstance(first, Virtual) and name == "tolist":
            WAITED.note()
            return first.inner.tolist()
        where = torch.device(kwargs["device"]) if kwargs.get("device") is not None else None
        if where is None and isinstance(first, Virtual):
            where = CUDA
        if kwargs.get("generator") is not None:
            refuse_generator(kwargs["generator"], where or torch.device("cpu"))
        if name == "quantile" and isinstance(first, Virtual):  # made of others that torch would put on the CPU
            return Virtual(func(first.inner, *args[1:], **kwargs))
        if name in ("linear", "matmul", "__matmul__") and isinstance(first, Virtual) and first.ndim == 1:
            return func(first[None], *args[1:], **kwargs)[0]  # torch would give its own result another shape in place
        if name == "new_tensor" and where is not None:
            made = torch.tensor(args[1], dtype=kwargs.get("dtype") or first.dtype)
            return Virtual(made) if where.type == "cuda" else made
        if where is not None and where.type == "cuda" and not isinstance(first, Virtual):
            wanted = kwargs.pop("requires_grad", False)
            found = Virtual(func(*args, **{**kwargs, "device": "cpu"}))
            return found.requires_grad_() if wanted else found
        return func(*args, **kwargs)

    def _to(self, func: Any, name: str, args: Any, kwargs: dict[str, Any]) -> Any:
        tensor, said = args[0], [*args[1:], kwargs.get("device"), kwargs.get("other"), kwargs.get("dtype")]
        devices = [x.device if isinstance(x, torch.Tensor) else x for x in said]
        devices = [torch.device(x) for x in devices if isinstance(x, (str, torch.device))]
        goal = torch.device({"cpu": "cpu", "cuda": "cuda"}[name]) if name != "to" else (devices or [None])[0]
        kinds = [x.dtype if isinstance(x, torch.Tensor) else x for x in said]
        kind = next((x for x in kinds if isinstance(x, torch.dtype)), tensor.dtype)
        if goal is None:
            return func(*args, **kwargs)
        if goal.type == tensor.device.type and kind == tensor.dtype and not kwargs.get("copy"):
            return tensor
        return _Move.apply(tensor, goal.type == "cuda", kind)


def _grouped(lists: list[Any], with_indices: bool = False) -> dict[Any, Any]:
    """torch's own, for optimisers whose parameters are all on one device; it would look behind the `Virtual`."""
    one = next(x for each in lists for x in each if x is not None)
    return {(one.device, one.dtype): (lists, list(range(len(lists[0]))))}


@contextmanager
def virtual_gpu() -> Iterator[Waits]:
    """Everything on "cuda" in here is on the virtual GPU; gives what made the host wait for it."""
    grouping = "_group_tensors_by_device_and_dtype"
    memory: Callable[..., int] = lambda *_: 0  # noqa: E731
    WAITED.clear()
    optimizer = import_module("torch.optim.optimizer")
    with (
        patch.object(torch, "Generator", Generator), patch.object(optimizer, grouping, _grouped),
        patch(f"torch.nn.utils.clip_grad.{grouping}", _grouped),
        patch("torch.cuda.max_memory_allocated", memory),
        patch("torch.__future__.get_overwrite_module_params_on_conversion", lambda: True), _Calls(),
    ):  # fmt: skip
        yield WAITED
