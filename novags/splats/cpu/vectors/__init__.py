"""The arithmetic of kernels: vectors of sixteen float32."""
