"""Kernels chained in compiled code: one call from Python runs many, on all threads, without the interpreter between."""
