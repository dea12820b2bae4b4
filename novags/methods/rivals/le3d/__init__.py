"""LE3D (Jin et al. 2024): its start, its colours, its regularisers, and the training."""
