"""Stages of chains: kernels whose ranges go to the next free thread, and parts that one thread does alone.

Every thread that takes part runs the whole chain. `control` counts, for each stage, the parts taken and the parts done;
no thread goes past a stage while any part of it is still being worked on. A thread that comes late finds nothing left
in the stages behind and runs through them; one that never comes is not waited for. So a chain is, like `parallel.run`,
as fast as the threads that the operating system does schedule, and its results do not depend on the sharing of work.
"""

# mypy: allow-untyped-defs

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler import inline

SLOT, DONE = 16, 8  # int64 per stage, of which the first counts parts taken and the one at DONE parts done;
# either has a cache line of its own
PATIENCE, NAP = 2000, 100  # tries, about half a millisecond; microseconds
STAGES = 32  # of the longest chain
CHUNKS_PER_THREAD = 6  # enough that the last chunk is short, few enough that handing out costs little
PARTS_PER_THREAD = 4  # of kernels that need the number of their parts beforehand


def new_control() -> np.ndarray:
    """Counters of one call of a chain, [STAGES * SLOT] int64."""
    return np.zeros(STAGES * SLOT, np.int64)


def give_up(control: np.ndarray) -> None:
    """Make all threads run to the end of the chain without doing any more, because one of them has failed."""
    control.fill(1 << 40)


@intrinsic
def _fetch_add(typingctx, array, index, value):
    """Add to an element of a flat int64 array, atomically; returns the value before."""

    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", builder.gep(data, [args[1]]), args[2], "seq_cst")

    return types.int64(array, types.int64, types.int64), codegen


def _call(builder: Any, name: str, *values: Any) -> None:
    """Call a function of the C library that takes integers and returns an int."""
    function = builder.module.globals.get(name)
    if function is None:
        function = ir.Function(builder.module, ir.FunctionType(ir.IntType(32), [v.type for v in values]), name)
    builder.call(function, values)


@intrinsic
def _let_others_run(typingctx):
    def codegen(context, builder, sig, args):
        _call(builder, "sched_yield")
        return context.get_dummy_value()

    return types.void(), codegen


@intrinsic
def _nap(typingctx):
    def codegen(context, builder, sig, args):
        _call(builder, "usleep", ir.Constant(ir.IntType(32), NAP))
        return context.get_dummy_value()

    return types.void(), codegen


@inline
def wait(control, stage, n):
    """Wait until n items of a stage are done: not long, unless the system has suspended a thread at work on them."""
    tries = 0
    while _fetch_add(control, stage * SLOT + DONE, 0) < n:
        tries += 1
        if tries < PATIENCE:
            _let_others_run()
        else:
            _nap()


@inline
def alone(control, stage):
    """Whether this thread has to do a stage of one item; it then has to call `done`, and all have to `wait`."""
    return _fetch_add(control, stage * SLOT, 1) == 0


@inline
def done(control, stage):
    """Mark a stage that one thread does `alone` as done."""
    _fetch_add(control, stage * SLOT + DONE, 1)


@inline
def parts(n, grain, threads):
    """How many parts n items are cut into for kernels that have to know; none is shorter than `grain`."""
    return max(1, min(PARTS_PER_THREAD * threads, n // grain))


def shared(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel(begin, end, *args) as the stage (control, stage, threads, n, grain, *args) of a chain."""

    @inline
    def work(control, stage, threads, n, grain, *args):
        step = -(-n // (threads * CHUNKS_PER_THREAD * grain)) * grain if threads > 1 else n
        begin = _fetch_add(control, stage * SLOT, step)
        while begin < n:
            end = min(begin + step, n)
            kernel(begin, end, *args)
            _fetch_add(control, stage * SLOT + DONE, end - begin)
            begin = _fetch_add(control, stage * SLOT, step)
        wait(control, stage, n)

    return work
