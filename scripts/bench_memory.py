"""Peak memory of every method on one capture, each reconstructed by the command line in a process of its own.

    novags render tabletop --out SET --views 50 --width 1000 --height 1000 --spp 4 --max-depth 3
    novags capture SET --out CAPTURE
    python scripts/bench_memory.py CAPTURE --out DIR

Every large array is there after a few iterations, so a reconstruction is stopped early (`--iterations`), and if wanted
after the first views that it rendered (`--views`). A row gives the largest resident memory of the process while it
trained and rendered, as /proc has it, and the forecast before.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from novags.methods import METHODS, VARIANTS

LOOK = 0.1  # s between two looks


def measured(capture: Path, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Reconstruct, and look at the process."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "novags",
            "reconstruct",
            str(capture),
            "--out",
            f"{folder}/run",
            "--method",
            name,
        ]
        command += ["--iterations", str(options.iterations), "--denoiser-steps", str(options.denoiser_steps)]
        command += ["--points", str(options.points)]
        began = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        peak, ended = 0, False
        while process.poll() is None:
            peak = max(peak, high_water_mark(process.pid))
            if options.views and len(list(Path(folder, "run").rglob("*.png"))) >= options.views:
                process.terminate()
                ended = True
                break
            time.sleep(LOOK)
        process.wait()
        said = process.stdout.read() if process.stdout else ""
    forecast = re.search(r"memory ([\d.]+) GB", said)
    return {
        "method": name, "peak_bytes": peak, "seconds": time.perf_counter() - began,
        "status": 0 if ended else process.returncode,
        "forecast_bytes": float(forecast[1]) * 1e9 if forecast else None, "said": said.splitlines()[-1:],
    }  # fmt: skip


def high_water_mark(pid: int) -> int:
    """Bytes; 0 if the process has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM")), 0)


def main() -> None:
    """Run as the module says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--methods", nargs="+", default=[*METHODS, *VARIANTS])
    parser.add_argument("--iterations", type=int, default=12)
    parser.add_argument("--denoiser-steps", type=int, default=4)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--views", type=int, help="rendered views after which a run is ended")
    parser.add_argument("--out", type=Path, help="folder for memory.json")
    options = parser.parse_args()
    rows = []
    for name in options.methods:
        rows.append(measured(options.capture, name, options))
        row = rows[-1]
        forecast = f"{row['forecast_bytes'] / 2**30:.2f}" if row["forecast_bytes"] else "-"
        end = "" if row["status"] == 0 else f"  status {row['status']}: {' '.join(row['said'])}"
        print(
            f"{name:20} {row['peak_bytes'] / 2**30:.2f} GiB, forecast {forecast}, {row['seconds']:.0f} s{end}",
            flush=True,
        )
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "memory.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
