"""What kernels compute with: vectors of sixteen float32."""
