"""The CPU engine: SIMD kernels compiled by numba, a thread pool to run them, and recycled memory.

Every kernel has the form `kernel(begin, end, *arrays)`, works on items begin..end-1 of its first dimension, releases
the GIL and touches nothing that another range touches; `parallel.run` spreads it over threads.
"""
