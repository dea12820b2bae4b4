"""The parts of `train_denoiser.py` and `bench_denoiser.py`: clean pictures, simulated pairs, training, rivals."""
