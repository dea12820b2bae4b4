"""The thread pool, that it changes no result, and the recycled memory."""

import gc
import multiprocessing
import threading
import time

import numpy as np
import pytest
import torch

from novags.splats import FitConfig, Gaussians, McmcConfig, Views, fit, photometric_loss, rasterize
from novags.splats.cpu.memory import SMALL, Recycler, empty
from novags.splats.cpu.parallel import run
from novags.splats.cpu.raster import sort
from novags.splats.training.updates.activate import activate
from novags.splats.training.updates.mcmc import add_noise


@pytest.fixture
def four_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(4)
    yield
    torch.set_num_threads(before)


def mark(begin, end, counts, grain):
    assert begin % grain == 0
    counts[begin:end] += 1


@pytest.mark.parametrize("n", [0, 1, 7, 100, 1001])
@pytest.mark.parametrize("grain", [1, 8, 2000])
def test_every_item_is_visited_once(four_threads, n, grain):
    counts = np.zeros(n, np.int64)
    run(mark, n, grain, counts, grain)
    assert (counts == 1).all()


def test_an_error_in_any_thread_reaches_the_caller_and_the_pool_lives_on(four_threads):
    def fail(begin, end):
        raise RuntimeError(f"at {begin}")

    with pytest.raises(RuntimeError, match="at "):
        run(fail, 100, 1)
    counts = np.zeros(50, np.int64)
    run(mark, 50, 1, counts, 1)
    assert (counts == 1).all()


def test_several_callers_share_the_pool(four_threads):
    results = [np.zeros(500, np.int64) for _ in range(6)]

    def call(counts):
        for _ in range(20):
            run(mark, 500, 1, counts, 1)

    threads = [threading.Thread(target=call, args=(counts,)) for counts in results]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all((counts == 20).all() for counts in results)


def _in_child(queue):
    counts = np.zeros(100, np.int64)
    run(mark, 100, 1, counts, 1)
    queue.put(int(counts.sum()))


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork.*:DeprecationWarning")
def test_a_forked_child_starts_its_own_threads(four_threads):
    run(mark, 100, 1, np.zeros(100, np.int64), 1)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_in_child, args=(queue,))
    child.start()
    assert queue.get(timeout=60) == 100
    child.join()


def test_memory_is_aligned_recycled_and_never_shared_while_in_use():
    a = empty((SMALL, 2))
    address = a.ctypes.data
    assert address % 64 == 0
    view = a[5:]
    del a
    gc.collect()
    b = empty((SMALL, 2))
    assert b.ctypes.data != address  # the view still looks into it
    del view
    gc.collect()
    assert empty((SMALL, 2)).ctypes.data == address


def test_a_tensor_keeps_its_memory():
    tensor = torch.from_numpy(empty(SMALL))
    tensor.fill_(3.0)
    gc.collect()
    empty(SMALL)[:] = 7.0
    assert (tensor == 3.0).all()


@pytest.mark.parametrize("shape", [0, (0, 3), 5, (2, 3, 4)])
def test_any_shape_and_type(shape):
    array = empty(shape, np.int64)
    assert array.shape == ((shape,) if isinstance(shape, int) else shape)
    assert array.dtype == np.int64
    array[...] = 1


def test_repeated_passes_keep_no_more_memory_than_the_first():
    memory, kept = Recycler(), []
    for _ in range(300):
        arrays = [memory.empty(size, np.uint8) for size in (9216, 20_000, 20_000, 1 << 20)]
        del arrays
        memory.empty(SMALL)
        kept.append(memory.free_bytes)
    assert kept[0] > 1 << 20
    assert set(kept[1:]) == {kept[1]}


def test_sizes_out_of_use_are_let_go_and_those_in_use_are_not():
    memory, size = Recycler(), 1 << 20
    for step in range(40):  # a scene that grows, through many sizes
        arrays = [memory.empty(int(size * 1.2**step), np.uint8) for _ in range(3)]
        in_use = sum(array.nbytes for array in arrays)
        del arrays
    memory.empty(SMALL)
    assert in_use < memory.free_bytes < 2.6 * in_use  # sizes are rounded up by at most a quarter
    before = memory.empty(int(size * 1.2**39), np.uint8).ctypes.data
    assert memory.empty(int(size * 1.2**39), np.uint8).ctypes.data == before
    for _ in range(100_000):  # and then a small one
        memory.empty(size, np.uint8)
    assert memory.free_bytes < 4 * size


def test_what_is_cleared_is_free_memory_alone() -> None:
    recycler = Recycler()
    kept, freed = recycler.empty(SMALL), recycler.empty(2 * SMALL)
    kept[:] = 7
    del freed
    recycler.clear()
    assert recycler.free_bytes == 0
    assert (kept == 7).all()
    del kept
    recycler.empty(10 * SMALL)  # when blocks that came back are counted
    assert recycler.free_bytes > 0


def test_several_threads_never_get_the_same_memory():
    memory, clashes = Recycler(), []

    def work(number: int) -> None:
        for _ in range(2000):
            array = memory.empty(SMALL, np.uint8)
            array[:] = number
            time.sleep(0)
            clashes.append(not (array == number).all())

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not any(clashes)
    memory.empty(SMALL, np.uint8)
    assert len(clashes) == 8000


def _photometric() -> list[torch.Tensor]:
    image, target = torch.rand(2, 130, 70, 3, generator=torch.Generator().manual_seed(0))
    image.requires_grad_()
    loss = photometric_loss(image, target, 0.2)
    return [loss, *torch.autograd.grad(loss, image)]


def _cloud(n: int = 20_000) -> Gaussians:
    g = torch.Generator().manual_seed(1)
    points = torch.randn(n, 3, generator=g)
    gaussians = Gaussians.from_points(points, torch.rand(n, 3, generator=g), sh_degree=0)
    gaussians.logit_opacities += torch.randn(n, generator=g) - 3
    return gaussians


def _activations() -> list[torch.Tensor]:
    gaussians = _cloud().requires_grad_()
    scales, opacities, regularizer = activate(gaussians, 0.01, 0.01)
    (scales.sum() + opacities.square().sum() + regularizer).backward()
    return [scales, opacities, regularizer, gaussians.log_scales.grad, gaussians.logit_opacities.grad]


def _noise() -> list[torch.Tensor]:
    gaussians = _cloud()
    add_noise(gaussians, 0.1, torch.Generator().manual_seed(2))
    return [gaussians.means]


def _fit() -> list[torch.Tensor]:
    view = torch.eye(4)
    view[2, 3] = 6.0
    views = Views(view[None], torch.tensor([[[50.0, 0, 32], [0, 50, 32], [0, 0, 1]]]), 64, 64)
    config = FitConfig(iterations=9, sh_every=3, mcmc=McmcConfig(refine_start=2, refine_every=3), cap_max=8500)
    image = torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(3))
    return list(fit(_cloud(8000), views, lambda i: image, config).gaussians.tensors().values())


@pytest.mark.parametrize("call", [_photometric, _activations, _noise, _fit])
def test_results_have_the_same_bits_for_any_number_of_threads(call):
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            results.append(call())
    finally:
        torch.set_num_threads(before)
    for others in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], others, strict=True))


def test_gaussians_of_all_parts_are_drawn_nearest_first_in_whatever_order_they_lie(four_threads):
    """Depths from 1 to 9 that fall, rise or come at random from part to part."""
    g = torch.Generator().manual_seed(0)
    n = 3 * sort.GRAIN + 5
    depth = 1 + 8 * torch.rand(n, generator=g).sort().values
    means = torch.cat([depth[:, None] * (torch.rand(n, 2, generator=g) - 0.5), depth[:, None]], 1)
    colors = torch.rand(n, 3, generator=g)
    viewmat, K = torch.eye(4)[None], torch.tensor([[[24.0, 0, 12], [0, 24, 12], [0, 0, 1]]])

    def drawn(order):
        quats = torch.tensor([1.0, 0, 0, 0]).expand(n, 4).contiguous()
        scales, opacities = 0.02 * depth[order, None].expand(n, 3).contiguous(), torch.full((n,), 0.3)
        image, _, _ = rasterize(
            means[order], quats, scales, opacities, colors[order], viewmat, K, 24, 24, sh_degree=None, backend="numba"
        )
        return image

    rising = drawn(torch.arange(n))
    for order in (torch.arange(n - 1, -1, -1), torch.randperm(n, generator=g)):
        torch.testing.assert_close(drawn(order), rising, rtol=1e-4, atol=1e-5)
