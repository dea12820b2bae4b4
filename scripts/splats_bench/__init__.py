"""The parts of `bench_splats.py`: its scenes and its whole training run."""
