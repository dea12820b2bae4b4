"""Processor time of the blind-spot denoiser, before and after, and the pictures that it makes in bfloat16.

python scripts/denoising/bench_steps.py steps --out steps.json
    milliseconds of one thread for a training step and for an inference, of the paper's network and of nova-fast's,
    in float32 and bfloat16: ours beside torch's own modules, by turns in one process; beside them the 3 x 3
    convolutions alone, which both need
python scripts/denoising/bench_steps.py precision --size 96 --seeds 0 1 2 --out precision.json
    aligned PSNR after some steps of the paper's denoiser in both precisions, of the same pictures and draws
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from novags.process import settle

os.environ["OMP_NUM_THREADS"] = "1"
settle()
sys.path.insert(0, str(Path(__file__).parents[1]))

import torch  # noqa: E402
from torch import nn  # noqa: E402

from denoising.plain import pair  # noqa: E402
from denoising.precision import PRECISIONS, trained  # noqa: E402
from novags.methods.nova.denoiser_config import FAST_DENOISER, DenoiserConfig  # noqa: E402

CONFIGS = {"paper": DenoiserConfig(), "fast": FAST_DENOISER}


def cpu_ms(work: Callable[[], Any]) -> float:
    started = time.process_time()
    work()
    return 1e3 * (time.process_time() - started)


def convolutions(network: nn.Module, picture: torch.Tensor, dtype: torch.dtype, rounds: int) -> tuple[float, float]:
    """Milliseconds that the 3 x 3 convolutions of a network take alone, forward, and forward and backward."""
    shapes: list[tuple[nn.Conv2d, torch.Size]] = []
    layers = [m for m in network.modules() if isinstance(m, nn.Conv2d) and m.kernel_size == (3, 3)]
    hooks = [m.register_forward_hook(lambda m, x, _: shapes.append((m, x[0].shape))) for m in layers]
    with torch.no_grad():
        network(picture)
    for hook in hooks:
        hook.remove()
    forward = both = 0.0
    for index, (layer, (count, _, height, width)) in enumerate(shapes):
        x, weight, slope = (torch.rand(shape).to(dtype).contiguous(memory_format=torch.channels_last) for shape in (
            (count, layer.in_channels, height + 2, width + 2), layer.weight.shape,
            (count, layer.out_channels, height, width)))  # fmt: skip
        bias, times = torch.zeros(layer.out_channels).to(dtype), []
        for _ in range(rounds):
            ahead = cpu_ms(lambda x=x, weight=weight, bias=bias: torch.conv2d(x, weight, bias))
            wanted = (index > 0, True, True)  # no gradient in the picture
            numbers = ([len(bias)], [1, 1], [0, 0], [1, 1], False, [0, 0], 1)
            back = torch.ops.aten.convolution_backward
            times.append((ahead, cpu_ms(lambda a=(slope, x, weight, *numbers, wanted), back=back: back(*a))))
        forward += min(t[0] for t in times)
        both += min(t[0] for t in times) + min(t[1] for t in times)
    return forward, both


def steps(size: int, rounds: int) -> list[dict[str, Any]]:
    views, rows = torch.rand(4, size, size, 3, generator=torch.Generator().manual_seed(0)), []
    for name, config in CONFIGS.items():
        for precision in PRECISIONS:
            chosen = replace(config, network=replace(config.network, precision=precision))
            denoisers = pair(views, chosen)
            for denoiser in denoisers:
                denoiser.train_step()
                denoiser.denoise_all()
            step, inference = ([[], []] for _ in range(2))
            for _ in range(rounds):
                for i, denoiser in enumerate(denoisers):
                    step[i].append(cpu_ms(denoiser.train_step))
                    with torch.no_grad():
                        inference[i].append(cpu_ms(lambda d=denoiser: d.denoise(0)))
            dtype = getattr(torch, precision)
            batch = denoisers[0]._draw_batch()
            alone = convolutions(denoisers[1].network, batch, dtype, rounds)[1]
            whole = convolutions(denoisers[1].network, views[:1].movedim(-1, 1), dtype, rounds)[0]
            for what, times, floor in (("step", step, alone), ("inference", inference, whole)):
                after, before = (float(np.median(t)) for t in times)
                rows.append({"network": name, "precision": precision, "what": what, "before": before, "after": after,
                             "ratio": before / after, "least_before": min(times[1]), "least_after": min(times[0]),
                             "convolutions": floor})  # fmt: skip
                print(f"{name:6} {precision:9} {what:10} before {before:6.1f} (least {min(times[1]):6.1f})  after "
                      f"{after:6.1f} (least {min(times[0]):6.1f})  ratio {before / after:4.2f}  convolutions alone "
                      f"{floor:6.1f} ms", flush=True)  # fmt: skip
    return rows


def processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    name, flags = (next(x for x in lines if x.startswith(key)).split(":")[1] for key in ("model name", "flags"))
    has = [flag for flag in ("avx512f", "avx512_bf16", "amx_bf16") if flag in flags.split()]
    return f"{name.strip()}, {', '.join(has) or 'no AVX-512'}{'' if 'amx_bf16' in has else ', no AMX'}"


def differences(rows: list[dict[str, Any]]) -> None:
    """bfloat16 minus float32, paired by picture; the error is over seeds, whose pictures share a training."""
    found = {(row["seed"], row["precision"]): row for row in rows}
    seeds = sorted({seed for seed, _ in found})
    for name in PRECISIONS:
        each = [found[s, name] for s in seeds]
        psnr, noisy, took = (np.mean([r[key] for r in each]) for key in ("psnr", "noisy", "cpu_seconds"))
        print(f"{name:9} {psnr:6.2f} dB, noisy {noisy:.2f}, {took:.0f} s")
    gaps = [float(np.mean(np.subtract(found[s, "bfloat16"]["psnr"], found[s, "float32"]["psnr"]))) for s in seeds]
    error = np.std(gaps, ddof=1) / np.sqrt(len(gaps)) if len(gaps) > 1 else np.nan
    print(f"bfloat16 - float32: {np.mean(gaps):+.2f} +- {error:.2f} dB, seeds {', '.join(f'{g:+.2f}' for g in gaps)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("steps", "precision"))
    parser.add_argument("--size", type=int, default=160, help="px, edge of a view")
    parser.add_argument("--rounds", type=int, default=9, help="of steps")
    parser.add_argument("--seeds", type=int, nargs="*", default=[0, 1, 2], help="of precision")
    parser.add_argument("--steps", type=int, default=500, help="of precision")
    parser.add_argument("--earlier", type=Path, nargs="*", default=[], help="results of --out of other seeds")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    print(processor())
    if asked.what == "steps":
        rows = steps(asked.size, asked.rounds)
    else:
        rows = [row for path in asked.earlier for row in json.loads(path.read_text())]
        for seed in asked.seeds:
            rows += [trained(seed, precision, asked.steps, asked.size) for precision in PRECISIONS]
        differences(rows)
    if asked.out is not None:
        asked.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
