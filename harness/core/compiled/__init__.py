"""Kernels in C++ for what Dr.Jit and PyTorch are slow at on a CPU: small networks over columns.

Built by the machine's own compiler when first needed and kept in the cache folder. Without a
compiler Dr.Jit and PyTorch do the same work, slower.
"""
